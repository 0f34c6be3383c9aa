"""Find the mesh files that a description names, inside the model's folder only."""

from __future__ import annotations

import posixpath
from pathlib import Path
from urllib.parse import unquote, urlsplit

from ikservo.files.reading import path_inside

_PACKAGE, _FILE = "package://", "file://"


def resolve_mesh_path(filename: str, urdf: Path, folder: Path) -> Path | None:
    """Return the file to which a mesh's name refers if it is in the model's folder, else None.

    A relative name is resolved from the URDF. ``package://NAME/REST`` is REST or NAME/REST, in the
    model's folder or in the URDF's. ``file://`` is an absolute path. The name itself is checked
    first, so that nothing outside is read.

    Args:
        filename: The name in the URDF.
        urdf: The URDF file.
        folder: The model's folder, which contains the URDF.
    """
    if filename.startswith(_PACKAGE):
        name = filename.removeprefix(_PACKAGE)
        package, _, rest = name.partition("/")
        if package in ("", ".", ".."):
            return None
        folders = (folder, urdf.parent)
        found = [path_inside(each, part) for each in folders for part in (name, rest)]
        inside = [path for path in found if path is not None]
        return next((path for path in inside if path.is_file()), inside[1] if inside[1:] else None)
    home = folder.resolve()
    if filename.startswith(_FILE):
        parts = urlsplit(filename)
        path = posixpath.normpath(unquote(parts.path))
        for base in (home, folder.absolute()) if parts.netloc in ("", "localhost") else ():
            if path.startswith(f"{base.as_posix()}/"):
                return path_inside(home, posixpath.relpath(path, base.as_posix()))
        return None
    beside = path_inside(urdf.parent, filename)
    place = urdf.parent.resolve()
    if beside or not filename.startswith("../") or not place.is_relative_to(home):
        return beside
    # The name leads out of the URDF's folder, perhaps to another subfolder of the model.
    name = posixpath.normpath(posixpath.join(place.relative_to(home).as_posix(), filename))
    return path_inside(home, name)

"""Find the file of a mesh that a description names, inside the model's folder only."""

from __future__ import annotations

import posixpath
from pathlib import Path
from urllib.parse import unquote, urlsplit

from ikservo.files.reading import path_inside

_PACKAGE, _FILE = "package://", "file://"


def resolve_mesh_path(filename: str, urdf: Path, folder: Path) -> Path | None:
    """Find the file of a mesh's name if it is under the model's folder, else None.

    A relative name is resolved from the URDF; ``package://NAME/REST`` is REST, or NAME/REST, in the
    model's folder or in the URDF's; ``file://`` is an absolute path. The spelling is checked first:
    nothing outside is read.

    Args:
        filename: The name in the URDF.
        urdf: The URDF file.
        folder: The model's folder, which contains the URDF.
    """
    if filename.startswith(_PACKAGE):
        return _resolve_package_path(filename.removeprefix(_PACKAGE), (folder, urdf.parent))
    if filename.startswith(_FILE):
        return _resolve_file_url(filename, folder)
    return path_inside(urdf.parent, filename) or _resolve_relative_path(filename, urdf, folder)


def _resolve_package_path(name: str, folders: tuple[Path, ...]) -> Path | None:
    package, _, rest = name.partition("/")
    if package in ("", ".", ".."):
        return None
    found = [path_inside(folder, each) for folder in folders for each in (name, rest)]
    inside = [path for path in found if path is not None]
    return next((path for path in inside if path.is_file()), inside[1] if inside[1:] else None)


def _resolve_file_url(url: str, folder: Path) -> Path | None:
    """Find the file of a file:// name: only as a path from the model's folder."""
    parts = urlsplit(url)
    path, home = posixpath.normpath(unquote(parts.path)), folder.resolve()
    if parts.netloc not in ("", "localhost"):
        return None
    for base in (home, folder.absolute()):
        if path.startswith(f"{base.as_posix()}/"):
            return path_inside(home, posixpath.relpath(path, base.as_posix()))
    return None


def _resolve_relative_path(filename: str, urdf: Path, folder: Path) -> Path | None:
    """Find the file of a name outside the URDF's folder but inside the model's."""
    home, place = folder.resolve(), urdf.parent.resolve()
    if not filename.startswith("../") or not place.is_relative_to(home):
        return None
    name = posixpath.normpath(posixpath.join(place.relative_to(home).as_posix(), filename))
    return path_inside(home, name)

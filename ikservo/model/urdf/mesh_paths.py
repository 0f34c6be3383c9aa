"""Where the mesh of a URDF lies: always under the model's own folder."""

from __future__ import annotations

import posixpath
from pathlib import Path
from urllib.parse import unquote, urlsplit

from ikservo.files.reading import path_inside

__all__ = ["mesh_path"]

_PACKAGE, _FILE = "package://", "file://"


def mesh_path(filename: str, urdf: Path, folder: Path) -> Path | None:
    """Return the file that a mesh's name means if it lies under the model's folder, else None.

    A relative name counts from the URDF; ``package://NAME/REST`` is REST, or NAME/REST, in the
    model's folder or in the URDF's; ``file://`` is an absolute path. The spelling is judged first:
    nothing outside is looked at.

    Args:
        filename: As the URDF has it.
        urdf: The file it stands in.
        folder: The model's folder, under which the URDF lies.
    """
    if filename.startswith(_PACKAGE):
        return _in_package(filename.removeprefix(_PACKAGE), (folder, urdf.parent))
    if filename.startswith(_FILE):
        return _absolute(filename, folder)
    return path_inside(urdf.parent, filename) or _beside(filename, urdf, folder)


def _in_package(name: str, folders: tuple[Path, ...]) -> Path | None:
    package, _, rest = name.partition("/")
    if package in ("", ".", ".."):
        return None
    found = [path_inside(folder, each) for folder in folders for each in (name, rest)]
    inside = [path for path in found if path is not None]
    return next((path for path in inside if path.is_file()), inside[1] if inside[1:] else None)


def _absolute(url: str, folder: Path) -> Path | None:
    """Return the file of a file:// name: only as a path from the model's folder."""
    parts = urlsplit(url)
    path, home = posixpath.normpath(unquote(parts.path)), folder.resolve()
    if parts.netloc not in ("", "localhost"):
        return None
    for base in (home, folder.absolute()):
        if path.startswith(f"{base.as_posix()}/"):
            return path_inside(home, posixpath.relpath(path, base.as_posix()))
    return None


def _beside(filename: str, urdf: Path, folder: Path) -> Path | None:
    """Return the file of a name that leads out of the URDF's folder, not out of the model's."""
    home, place = folder.resolve(), urdf.parent.resolve()
    if not filename.startswith("../") or not place.is_relative_to(home):
        return None
    name = posixpath.normpath(posixpath.join(place.relative_to(home).as_posix(), filename))
    return path_inside(home, name)

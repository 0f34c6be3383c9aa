"""Reading the triangles of a mesh file: STL, OBJ, PLY, glTF."""

from __future__ import annotations

import importlib
from pathlib import Path
from typing import Any

import numpy as np

from ikservo.errors import FileFormatError, InputError
from ikservo.files.reading import path_inside
from ikservo.model.meshes.fitting import Triangles

__all__ = ["read_triangles"]

_FORMATS = (".stl", ".obj", ".ply", ".glb", ".gltf", ".dae")
_LARGEST_BYTES = 64 * 1024 * 1024
_MOST_TRIANGLES = 1_000_000


def read_triangles(path: Path, data: bytes, link: str) -> Triangles:
    """Return the corners of all triangles (n, 3, 3), in the file's own unit.

    Files that the mesh names (buffers of glTF) are read from its own folder only.

    Args:
        path: Where the mesh came from: its suffix is its format.
        data: Its content.
        link: Whose shape it is, for the messages.

    Raises:
        FileFormatError: It is none of the known formats, damaged, empty or too large.
        InputError: The extra ``mesh`` is not installed.
    """
    place, suffix = f"mesh of link {link}", path.suffix.lower()
    if suffix not in _FORMATS:
        expected = f"one of {', '.join(_FORMATS)}"
        raise FileFormatError(path, place, f"its format is {suffix or 'unnamed'}", expected)
    if len(data) > _LARGEST_BYTES:
        raise FileFormatError(path, place, "it is larger than 64 MiB", "a simpler collision mesh")
    triangles = _loaded(path, data, place)
    if len(triangles) > _MOST_TRIANGLES:
        found = f"it has {len(triangles):,} triangles"
        raise FileFormatError(path, place, found, "a simpler collision mesh")
    if not len(triangles) or not np.isfinite(triangles).all():
        raise FileFormatError(path, place, "it has no triangles", "a surface of triangles")
    return triangles


def _loaded(path: Path, data: bytes, place: str) -> Triangles:
    trimesh = _trimesh(path, place)
    file = trimesh.util.wrap_as_stream(data)
    try:
        mesh = trimesh.load(
            file,
            file_type=path.suffix.lower()[1:],
            force="mesh",
            process=False,
            skip_materials=True,
            resolver=_FolderResolver(path.parent),
        )
        return np.array(mesh.triangles, dtype=np.float64).reshape(-1, 3, 3)
    except Exception as error:  # trimesh raises whatever the damage leads to
        why = " ".join(str(error).split())[:120] or type(error).__name__
        raise FileFormatError(path, place, f"it cannot be read ({why})", "a whole mesh") from error


def _trimesh(path: Path, place: str) -> Any:  # noqa: ANN401  # it has no types
    try:
        return importlib.import_module("trimesh")
    except ImportError:
        raise InputError(
            f"{path}, {place}: reading meshes needs trimesh, which is not installed.",
            "Install it: pip install 'ikservo[mesh]'",
        ) from None


class _FolderResolver:
    """Gives trimesh the files that a mesh names, from its own folder only."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def get(self, name: str) -> bytes:
        """Return the content of a file; none outside the folder is looked at."""
        path = path_inside(self._folder, name)
        if path is None or not path.is_file():
            raise ValueError(f"{name!r} is not a file in the mesh's folder")
        with path.open("rb") as file:
            return file.read(_LARGEST_BYTES)

    def __getitem__(self, name: str) -> bytes:
        return self.get(name)

    def keys(self) -> list[str]:
        """Return no names: nothing is searched for."""
        return []

    def namespaced(self, _: str) -> _FolderResolver:
        """Return itself: names count from the folder."""
        return self

"""Read the triangles of mesh files of limited size: STL, OBJ, PLY, glTF and Collada."""

from __future__ import annotations

import contextlib
import importlib
import json
import logging
import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np

from ikservo.apps.importing.collada import check_collada
from ikservo.apps.importing.mesh_capsules import Triangles
from ikservo.errors import FileFormatError, InputError
from ikservo.files.reading import path_inside
from ikservo.model.urdf_types import Mesh
from ikservo.remedies import install_command

_FORMATS = (".stl", ".obj", ".ply", ".glb", ".gltf", ".dae")
_MAX_BYTES = 32 * 1024 * 1024
MAX_TRIANGLES = 300_000
"""Largest number of triangles in a mesh. Fitting that many takes up to half a minute, once."""
_UNIT_BYTES = 64 * 1024
_UNIT = re.compile(rb"""<unit\b[^>]*\bmeter\s*=\s*["']([0-9.eE+-]{1,24})["']""")
_STL_HEAD_BYTES, _STL_TRIANGLE_BYTES, _GLB_HEAD_BYTES = 84, 50, 20


def read_triangles(path: Path, data: bytes, link: str) -> Triangles:
    """Read the corners (n, 3, 3) of all triangles, in the file's own unit; Collada in metres.

    Files that the mesh names (buffers of glTF) are read from its own folder only. The suffix of the
    path determines the format; ``link``, the owner of the shape, is used in messages.

    Raises:
        FileFormatError: The file has an unknown format, or is damaged, empty or too large.
        InputError: The extra ``import`` is not installed.
    """
    place, suffix = f"mesh of link {link}", path.suffix.lower()
    if suffix not in _FORMATS:
        expected = f"one of {', '.join(_FORMATS)}"
        raise FileFormatError(path, place, f"its format is {suffix or 'unknown'}", expected)
    if len(data) > _MAX_BYTES:
        raise FileFormatError(
            path, place, "the file is larger than 32 MiB", "a simpler collision mesh"
        )
    if suffix == ".dae":
        check_collada(path, place, data, MAX_TRIANGLES)
    _check_count(path, place, _stated_triangles(suffix, data))
    triangles = _load_mesh(path, data, place)
    _check_count(path, place, len(triangles))
    if suffix == ".dae":
        unit = _UNIT.search(data[:_UNIT_BYTES])
        metre = 1.0
        with contextlib.suppress(ValueError):
            metre = float(unit[1]) if unit else 1.0
        triangles *= metre if 1e-6 <= metre <= 1e3 else 1.0
    if not len(triangles) or not np.isfinite(triangles).all():
        raise FileFormatError(path, place, "it has no triangles", "a surface of triangles")
    return triangles


def _check_count(path: Path, place: str, triangles: float) -> None:
    if triangles > MAX_TRIANGLES:
        found, most = f"it has {triangles:,.0f} triangles", f"at most {MAX_TRIANGLES:,} triangles"
        raise FileFormatError(path, place, found, f"{most}; simplify the mesh")


def _stated_triangles(suffix: str, data: bytes) -> float:
    """Estimate the number of triangles in a file without loading it; 0 if unknown."""
    if suffix == ".stl" and len(data) > _STL_HEAD_BYTES and not data.startswith(b"solid"):
        return (len(data) - _STL_HEAD_BYTES) // _STL_TRIANGLE_BYTES
    if suffix == ".obj":
        return data.count(b"\nf ")
    if suffix in (".gltf", ".glb"):
        start = _GLB_HEAD_BYTES if suffix == ".glb" else 0
        length = int.from_bytes(data[12:16], "little") if suffix == ".glb" else len(data)
        with contextlib.suppress(ValueError, TypeError, AttributeError, KeyError, RecursionError):
            tree: Any = json.loads(data[start : start + length])
            counts: list[float] = [each.get("count", 0) for each in tree.get("accessors", ())]
            meshes: list[float] = []
            for mesh in tree.get("meshes", ()):
                used: list[int] = [
                    p.get("indices", p["attributes"]["POSITION"]) for p in mesh["primitives"]
                ]
                meshes.append(sum(counts[accessor] for accessor in used))
            nodes: list[int] = [node["mesh"] for node in tree.get("nodes", ()) if "mesh" in node]
            corners = max(sum(meshes[mesh] for mesh in nodes), *counts, 0)
            return corners / 3
    return 0


def _load_mesh(path: Path, data: bytes, place: str) -> Triangles:
    try:
        trimesh: Any = importlib.import_module("trimesh")  # it has no types
    except ImportError:
        raise InputError(
            f"{path}, {place}: reading meshes needs trimesh, which is not installed.",
            f"Install it: {install_command('import')}",
        ) from None
    file = trimesh.util.wrap_as_stream(data)
    logging.getLogger("trimesh").addHandler(logging.NullHandler())  # silences the terminal
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            mesh = trimesh.load(
                file,
                file_type=path.suffix.lower()[1:],
                force="mesh",
                process=False,
                skip_materials=True,
                resolver=_FolderResolver(path.parent),
            )
        return np.array(mesh.triangles, dtype=np.float64).reshape(-1, 3, 3)
    except Exception as error:  # trimesh raises any exception for damaged files
        why = " ".join(str(error).split())[:120] or type(error).__name__
        raise FileFormatError(
            path, place, f"it cannot be read ({why})", "an intact mesh"
        ) from error


class _FolderResolver:
    """Resolver that gives trimesh the files that a mesh names, only from the mesh's folder."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    def get(self, name: str) -> bytes:
        """Return the content of a file.

        Raises:
            ValueError: There is no such file in the folder.
        """
        path = path_inside(self._folder, name)
        if path is None or not path.is_file():
            raise ValueError(f"{name!r} is not a file in the mesh's folder")
        with path.open("rb") as file:
            return file.read(_MAX_BYTES)

    def __getitem__(self, name: str) -> bytes:
        return self.get(name)

    def keys(self) -> list[str]:
        """Return no names, because trimesh is not meant to search for files."""
        return []

    def namespaced(self, _: str) -> _FolderResolver:
        """Return this resolver, because all names are relative to the folder."""
        return self


def mesh_triangles(link: str, mesh: Mesh) -> Triangles:
    """Return the corners of a mesh's triangles (n, 3, 3) [m] in its own frame.

    Raises:
        FileFormatError: The file is missing, outside the folder, or cannot be used.
        InputError: The extra ``import`` is not installed.
    """
    place = f"mesh of link {link}"
    if mesh.path is None:
        expected = "a file in the model's own folder, as a relative path, package:// or file://"
        raise FileFormatError(mesh.filename, place, "it is outside the model's folder", expected)
    if not mesh.path.is_file():
        expected = "the mesh, or <collision> shapes of boxes, cylinders and spheres"
        raise FileFormatError(mesh.path, place, "the file does not exist", expected)
    with mesh.path.open("rb") as file:
        data = file.read(_MAX_BYTES + 1)
    return read_triangles(mesh.path, data, link) * np.array(mesh.scale)

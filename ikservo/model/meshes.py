"""Meshes of a description as capsules that contain them, fitted once and cached."""

from __future__ import annotations

import contextlib
import hashlib
import importlib
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from platformdirs import user_cache_path

from ikservo.errors import FileFormatError, InputError
from ikservo.files.reading import path_inside
from ikservo.files.writing import FileWriteError, write_atomic
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.se3 import rotation_rpy
from ikservo.model.collada import check_collada
from ikservo.model.urdf_types import Mesh, Surface, Triple

__all__ = [
    "FittedCapsule",
    "capsules_around_mesh",
    "capsules_around_surface",
    "fit_capsules",
    "read_triangles",
]


# Splitting ends where the capsules have at most this many times the volume of what they contain.
_TIGHT = 1.7
_MAX_CAPSULES = 8
# A split must reduce a capsule's volume by this fraction.
_GAIN = 0.05
_CIRCLE_STEPS = 120
# Of more corners only those that are the farthest along one of some directions are taken for the
# shape of a part; its capsule contains them all nevertheless.
_MAX_CORNERS = 60_000
_DIRECTIONS = 256
_BLOCK = 2048

Triangles = NDArray[np.float64]
"""Corners (n, 3, 3), metres."""


@dataclass(frozen=True, slots=True, eq=False)
class FittedCapsule:
    """A capsule: both ends of its axis (3,) and its radius, metres."""

    start_m: Vector
    end_m: Vector
    radius_m: float

    @property
    def volume_m3(self) -> float:
        """Its volume."""
        length_m = float(np.linalg.norm(self.end_m - self.start_m))
        return math.pi * self.radius_m**2 * (length_m + 4.0 / 3.0 * self.radius_m)


@dataclass(frozen=True, slots=True, eq=False)
class _MeshPart:
    """Some of the triangles, the capsule around them and the volume of their convex hull."""

    triangles: Triangles
    fit: FittedCapsule
    hull_m3: float


def fit_capsules(triangles: Triangles) -> list[FittedCapsule]:
    """Find capsules that together contain a surface, and the solid inside if it is closed.

    The surface is cut by planes where that makes the capsules smaller. Each capsule contains the
    convex hull of its part, so cutting leaves no gap.

    Args:
        triangles: At least one.
    """
    parts, final = [_make_part(triangles)], list[_MeshPart]()
    while parts and len(parts) + len(final) < _MAX_CAPSULES:
        together = [*parts, *final]
        if sum(p.fit.volume_m3 for p in together) <= _TIGHT * sum(p.hull_m3 for p in together):
            break
        worst = max(parts, key=lambda part: part.fit.volume_m3 - part.hull_m3)
        parts.remove(worst)
        halves = _best_split(worst)
        if halves:
            parts.extend(halves)
        else:
            final.append(worst)
    return [part.fit for part in (*parts, *final)]


def _make_part(triangles: Triangles) -> _MeshPart:
    points = triangles.reshape(-1, 3)
    corners, hull_m3 = _convex_hull(points)
    fit, axis = _smallest_capsule(corners)
    if len(points) > _MAX_CORNERS:
        fit = _capsule_along(corners, axis, points)
    return _MeshPart(triangles, fit, hull_m3)


def _best_split(part: _MeshPart) -> list[_MeshPart]:
    """Find the two parts of the cut with the smallest capsules; none if none helps."""
    points = part.triangles.reshape(-1, 3)
    best, min_m3 = list[_MeshPart](), (1.0 - _GAIN) * part.fit.volume_m3
    for axis in (*np.eye(3), _main_axis(points)):
        along = points @ axis
        halves = _cut_by_plane(part.triangles, axis, 0.5 * (along.min() + along.max()))
        if all(len(half) for half in halves):
            found = [_make_part(half) for half in halves]
            volume_m3 = sum(half.fit.volume_m3 for half in found)
            if volume_m3 < min_m3:
                best, min_m3 = found, volume_m3
    return best


def _cut_by_plane(triangles: Triangles, axis: Vector, at_m: float) -> tuple[Triangles, Triangles]:
    """Return the triangles on both sides of a plane; those that cross it are cut in three."""
    side = triangles @ axis - at_m
    above, below = (side >= 0.0).all(axis=1), (side < 0.0).all(axis=1)
    crossing, side = triangles[~above & ~below], side[~above & ~below]
    lone_above = (side >= 0.0).sum(axis=1) == 1
    farthest: list[NDArray[np.intp]] = [side.argmin(axis=1), side.argmax(axis=1)]
    ordered = (np.choose(lone_above, farthest)[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(crossing, ordered[:, :, None], axis=1).transpose(1, 0, 2)
    s_a, s_b, s_c = np.take_along_axis(side, ordered, axis=1).T[..., None]
    p, q = a + (b - a) * s_a / (s_a - s_b), a + (c - a) * s_a / (s_a - s_c)
    tips = np.stack([a, p, q], axis=1)
    feet = np.concatenate([np.stack([p, b, c], axis=1), np.stack([p, c, q], axis=1)])
    feet_above = np.tile(~lone_above, 2)
    return (
        np.concatenate([triangles[above], tips[lone_above], feet[feet_above]]),
        np.concatenate([triangles[below], tips[~lone_above], feet[~feet_above]]),
    )


def _convex_hull(points: Matrix) -> tuple[Matrix, float]:
    """Compute the corners (k, 3) and the volume of a convex hull; a flat one has none.

    Those of many points are within a percent of a smooth surface.
    """
    from scipy.spatial import ConvexHull, QhullError  # noqa: PLC0415

    if len(points) > _MAX_CORNERS:
        points = points[_farthest(points)]
    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return np.unique(points, axis=0), 0.0
    return points[hull.vertices], float(hull.volume)


def _farthest(points: Matrix) -> NDArray[np.intp]:
    """Return which points (n, 3) are the farthest along evenly spread directions."""
    i = np.arange(_DIRECTIONS) + 0.5
    turn, z = math.pi * (1.0 + math.sqrt(5.0)) * i, 1.0 - 2.0 * i / _DIRECTIONS
    around = np.sqrt(1.0 - z**2)
    directions = np.stack([around * np.cos(turn), around * np.sin(turn), z]).astype(np.float32)
    most, which = np.full(_DIRECTIONS, -np.inf), np.zeros(_DIRECTIONS, dtype=np.intp)
    for first in range(0, len(points), _BLOCK):  # what fits into a processor's cache
        along = points[first : first + _BLOCK].astype(np.float32) @ directions
        block_most = along.max(axis=0)
        farther = block_most > most
        which[farther] = first + along[:, farther].argmax(axis=0)
        most[farther] = block_most[farther]
    return np.unique(which)


def _smallest_capsule(points: Matrix) -> tuple[FittedCapsule, Vector]:
    """Find the smallest capsule around points (n, 3) with one of some axes, and its axis."""
    axes = (*np.eye(3), *_main_axes(points))
    fits = [(_capsule_along(points, axis, points), axis) for axis in axes]
    return min(fits, key=lambda fit: fit[0].volume_m3)


def _main_axes(points: Matrix) -> Matrix:
    """Compute the principal axes (3, 3) of points, one a row, the longest first."""
    every_axis = len(points) < 3  # else its first matrix would be as large as the points' square
    return np.linalg.svd(points - points.mean(axis=0), full_matrices=every_axis)[2]


def _main_axis(points: Matrix) -> Vector:
    return _main_axes(_convex_hull(points)[0])[0]


def _capsule_along(corners: Matrix, axis: Vector, points: Matrix) -> FittedCapsule:
    """Return the capsule along an axis around corners (k, 3) that contains points (n, 3)."""
    across = np.linalg.svd(axis[None])[2][1:]
    centre = _enclosing_circle_centre(corners @ across.T)
    flat, along = points @ across.T, points @ axis
    away_m = np.linalg.norm(flat - centre, axis=1)
    radius_m = float(away_m.max()) + 1e-9
    cap_m = np.sqrt(np.maximum(radius_m**2 - away_m**2, 0.0))
    start, end = float((along + cap_m).min()), float((along - cap_m).max())
    if start > end:  # one ball contains them all
        start = end = 0.5 * (start + end)
    return FittedCapsule(centre @ across + start * axis, centre @ across + end * axis, radius_m)


def _enclosing_circle_centre(flat: Matrix) -> Vector:
    """Return nearly the centre (2,) of the smallest circle around points (Badoiu and Clarkson)."""
    centre = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    best, min_m = centre, math.inf
    for i in range(_CIRCLE_STEPS):
        away_m = np.linalg.norm(flat - centre, axis=1)
        farthest = int(away_m.argmax())
        if away_m[farthest] < min_m:
            best, min_m = centre, float(away_m[farthest])
        centre = centre + (flat[farthest] - centre) / (i + 2)
    return best


_FORMATS = (".stl", ".obj", ".ply", ".glb", ".gltf", ".dae")
_MAX_BYTES = 32 * 1024 * 1024
MAX_TRIANGLES = 300_000
"""Of a mesh; half a minute of fitting at worst, once."""
_STL_HEAD_BYTES, _STL_TRIANGLE_BYTES, _GLB_HEAD_BYTES = 84, 50, 20


def read_triangles(path: Path, data: bytes, link: str) -> Triangles:
    """Read the corners of all triangles (n, 3, 3), in the file's own unit.

    Files that the mesh names (buffers of glTF) are read from its own folder only.

    Args:
        path: The origin of the mesh: its suffix is its format.
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
    if len(data) > _MAX_BYTES:
        raise FileFormatError(path, place, "it is larger than 32 MiB", "a simpler collision mesh")
    if suffix == ".dae":
        check_collada(path, place, data, MAX_TRIANGLES)
    _check_count(path, place, _stated_triangles(suffix, data))
    triangles = _load_mesh(path, data, place)
    _check_count(path, place, len(triangles))
    if not len(triangles) or not np.isfinite(triangles).all():
        raise FileFormatError(path, place, "it has no triangles", "a surface of triangles")
    return triangles


def _check_count(path: Path, place: str, triangles: float) -> None:
    if triangles > MAX_TRIANGLES:
        found, expected = f"it has {triangles:,.0f} triangles", f"at most {MAX_TRIANGLES:,}"
        raise FileFormatError(path, place, found, f"{expected}; a simpler collision mesh")


def _stated_triangles(suffix: str, data: bytes) -> float:
    """Compute how many triangles a file says it has, before room is made for them; 0 if unknown."""
    if suffix == ".stl" and len(data) > _STL_HEAD_BYTES and not data.startswith(b"solid"):
        return (len(data) - _STL_HEAD_BYTES) // _STL_TRIANGLE_BYTES
    if suffix == ".obj":
        return data.count(b"\nf ")
    if suffix in (".gltf", ".glb"):
        start = _GLB_HEAD_BYTES if suffix == ".glb" else 0
        length = int.from_bytes(data[12:16], "little") if suffix == ".glb" else len(data)
        with contextlib.suppress(ValueError, TypeError, AttributeError, KeyError, RecursionError):
            return _gltf_triangles(json.loads(data[start : start + length]))
    return 0


def _gltf_triangles(tree: Any) -> float:  # noqa: ANN401  # JSON of any shape
    """Compute the corners in all primitives of all nodes, a third of them, as glTF counts them."""
    counts: list[float] = [accessor.get("count", 0) for accessor in tree.get("accessors", ())]
    meshes: list[float] = []
    for mesh in tree.get("meshes", ()):
        used: list[int] = [
            p.get("indices", p["attributes"]["POSITION"]) for p in mesh["primitives"]
        ]
        meshes.append(sum(counts[accessor] for accessor in used))
    nodes: list[int] = [node["mesh"] for node in tree.get("nodes", ()) if "mesh" in node]
    return max(sum(meshes[mesh] for mesh in nodes), *counts, 0) / 3


def _load_mesh(path: Path, data: bytes, place: str) -> Triangles:
    trimesh = _import_trimesh(path, place)
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


def _import_trimesh(path: Path, place: str) -> Any:  # noqa: ANN401  # it has no types
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
        """Get the content of a file; files outside the folder are not read."""
        path = path_inside(self._folder, name)
        if path is None or not path.is_file():
            raise ValueError(f"{name!r} is not a file in the mesh's folder")
        with path.open("rb") as file:
            return file.read(_MAX_BYTES)

    def __getitem__(self, name: str) -> bytes:
        return self.get(name)

    def keys(self) -> list[str]:
        """Return no names: nothing is searched for."""
        return []

    def namespaced(self, _: str) -> _FolderResolver:
        """Return itself: names count from the folder."""
        return self


_VERSION = "1"  # of the fitting: another number invalidates the cache


def capsules_around_mesh(link: str, mesh: Mesh) -> list[Capsule]:
    """Return capsules that contain a mesh, in link coordinates.

    Raises:
        FileFormatError: The mesh is missing, outside the model's folder, or cannot be used; names
            the link.
        InputError: The extra ``mesh`` is not installed.
    """
    path = _mesh_file(link, mesh)
    fits = _fit_file(path, path.stat().st_mtime_ns, mesh.scale, link)
    return _place_capsules(link, fits, mesh.xyz_m, mesh.rpy_rad)


def mesh_triangles(link: str, mesh: Mesh) -> Triangles:
    """Return the corners of a mesh's triangles (n, 3, 3) [m] in its own frame.

    Raises:
        FileFormatError: As ``capsules_around_mesh``.
        InputError: The extra ``mesh`` is not installed.
    """
    path = _mesh_file(link, mesh)
    with path.open("rb") as file:
        data = file.read(_MAX_BYTES + 1)
    return read_triangles(path, data, link) * np.array(mesh.scale)


def capsules_around_surface(link: str, surface: Surface) -> list[Capsule]:
    """Return capsules that contain a surface, in link coordinates."""
    triangles = np.ascontiguousarray(surface.triangles_m)
    fits = _fit_cached(_cache_key("", triangles.tobytes()), lambda: triangles)
    return _place_capsules(link, fits, surface.xyz_m, surface.rpy_rad)


def _place_capsules(
    link: str, fits: Sequence[FittedCapsule], xyz_m: Triple, rpy_rad: Triple
) -> list[Capsule]:
    R, origin_m = rotation_rpy(*rpy_rad), np.array(xyz_m)
    return [
        Capsule(link, origin_m + R @ fit.start_m, origin_m + R @ fit.end_m, fit.radius_m)
        for fit in fits
    ]


def _mesh_file(link: str, mesh: Mesh) -> Path:
    place = f"mesh of link {link}"
    if mesh.path is None:
        expected = "a file in the model's own folder, as relative path, package:// or file://"
        raise FileFormatError(mesh.filename, place, "it is outside the model's folder", expected)
    if not mesh.path.is_file():
        expected = "the mesh, or <collision> shapes of boxes, cylinders and spheres"
        raise FileFormatError(mesh.path, place, "the file does not exist", expected)
    return mesh.path


@lru_cache(maxsize=256)
def _fit_file(
    path: Path, changed_ns: int, scale: tuple[float, float, float], link: str
) -> tuple[FittedCapsule, ...]:
    """Fit the capsules around a mesh file; one that was changed is read again."""
    with path.open("rb") as file:
        data = file.read(_MAX_BYTES + 1)
    key = _cache_key(f"{path.suffix.lower()} {scale}", data)
    return _fit_cached(key, lambda: read_triangles(path, data, link) * np.array(scale))


def _cache_key(what: str, data: bytes) -> str:
    return hashlib.sha256(f"{_VERSION} {what}".encode() + data).hexdigest()


def _fit_cached(key: str, triangles: Callable[[], Triangles]) -> tuple[FittedCapsule, ...]:
    """Return the cached capsules of a key, or fit and cache them."""
    path = user_cache_path("ikservo") / "meshes" / f"{key}.json"
    found = _read_cached_fit(path)
    if found is None:
        found = tuple(fit_capsules(triangles()))
        with contextlib.suppress(FileWriteError, OSError):  # the cache is optional
            write_atomic(path, json.dumps([_fit_numbers(fit) for fit in found]))
    return found


def _fit_numbers(fit: FittedCapsule) -> list[float]:
    return [*fit.start_m.tolist(), *fit.end_m.tolist(), fit.radius_m]


def _read_cached_fit(path: Path) -> tuple[FittedCapsule, ...] | None:
    """Read the capsules that an earlier run fitted; None if there are none usable."""
    try:
        rows = np.array(json.loads(path.read_text(encoding="utf-8")), dtype=np.float64)
    except (OSError, ValueError):
        return None
    if rows.ndim != 2 or rows.shape[1] != 7 or not np.isfinite(rows).all():
        return None
    return tuple(FittedCapsule(row[:3], row[3:6], float(row[6])) for row in rows)

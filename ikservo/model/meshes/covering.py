"""Capsules around a mesh of a link, read and fitted once and kept in the user's cache."""

from __future__ import annotations

import contextlib
import hashlib
import json
from collections.abc import Callable, Sequence
from functools import lru_cache
from pathlib import Path

import numpy as np
from platformdirs import user_cache_path

from ikservo.errors import FileFormatError
from ikservo.files.writing import FileWriteError, write_whole
from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.se3 import rotation_rpy
from ikservo.model.meshes.fitting import Fit, Triangles, fit_capsules
from ikservo.model.meshes.reading import read_triangles
from ikservo.model.urdf.parts import Mesh, Surface, Vector

__all__ = ["capsules_around_mesh", "capsules_around_surface"]

_VERSION = "1"  # of the fitting: another number forgets what was kept
_LARGEST_BYTES = 64 * 1024 * 1024


def capsules_around_mesh(link: str, mesh: Mesh) -> list[Capsule]:
    """Return capsules that contain a mesh, in link coordinates.

    Raises:
        FileFormatError: The mesh is missing, outside the model's folder, or cannot be used; names
            the link.
        InputError: The extra ``mesh`` is not installed.
    """
    path = _file_of(link, mesh)
    fits = _fits(path, path.stat().st_mtime_ns, mesh.scale, link)
    return _placed(link, fits, mesh.xyz_m, mesh.rpy_rad)


def capsules_around_surface(link: str, surface: Surface) -> list[Capsule]:
    """Return capsules that contain a surface, in link coordinates."""
    triangles = np.ascontiguousarray(surface.triangles_m)
    fits = _kept(_key("", triangles.tobytes()), lambda: triangles)
    return _placed(link, fits, surface.xyz_m, surface.rpy_rad)


def _placed(link: str, fits: Sequence[Fit], xyz_m: Vector, rpy_rad: Vector) -> list[Capsule]:
    R, origin_m = rotation_rpy(*rpy_rad), np.array(xyz_m)
    return [
        Capsule(link, origin_m + R @ fit.start_m, origin_m + R @ fit.end_m, fit.radius_m)
        for fit in fits
    ]


def _file_of(link: str, mesh: Mesh) -> Path:
    place = f"mesh of link {link}"
    if mesh.path is None:
        expected = "a file in the model's own folder, as relative path, package:// or file://"
        raise FileFormatError(mesh.filename, place, "it is outside the model's folder", expected)
    if not mesh.path.is_file():
        expected = "the mesh, or <collision> shapes of boxes, cylinders and spheres"
        raise FileFormatError(mesh.path, place, "the file does not exist", expected)
    return mesh.path


@lru_cache(maxsize=256)
def _fits(
    path: Path, changed_ns: int, scale: tuple[float, float, float], link: str
) -> tuple[Fit, ...]:
    """Return the capsules around a mesh file; one that was changed is read again."""
    with path.open("rb") as file:
        data = file.read(_LARGEST_BYTES + 1)
    key = _key(f"{path.suffix.lower()} {scale}", data)
    return _kept(key, lambda: read_triangles(path, data, link) * np.array(scale))


def _key(what: str, data: bytes) -> str:
    return hashlib.sha256(f"{_VERSION} {what}".encode() + data).hexdigest()


def _kept(key: str, triangles: Callable[[], Triangles]) -> tuple[Fit, ...]:
    """Return the capsules kept under a key, or fit them and keep them."""
    path = user_cache_path("ikservo") / "meshes" / f"{key}.json"
    found = _read_kept(path)
    if found is None:
        found = tuple(fit_capsules(triangles()))
        with contextlib.suppress(FileWriteError, OSError):  # a cache is no need
            write_whole(path, json.dumps([_numbers(fit) for fit in found]))
    return found


def _numbers(fit: Fit) -> list[float]:
    return [*fit.start_m.tolist(), *fit.end_m.tolist(), fit.radius_m]


def _read_kept(path: Path) -> tuple[Fit, ...] | None:
    """Return what an earlier run fitted; None where there is nothing usable."""
    try:
        rows = np.array(json.loads(path.read_text(encoding="utf-8")), dtype=np.float64)
    except (OSError, ValueError):
        return None
    if rows.ndim != 2 or rows.shape[1] != 7 or not np.isfinite(rows).all():
        return None
    return tuple(Fit(row[:3], row[3:6], float(row[6])) for row in rows)

"""Capsules that contain a surface of triangles, few and tight."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["Fit", "fit_capsules"]

# Splitting ends where the capsules have at most this many times the volume of what they contain.
_TIGHT = 1.7
_MOST_CAPSULES = 8
# A split must take away this share of a capsule's volume.
_GAIN = 0.05
_CIRCLE_STEPS = 120

Triangles = NDArray[np.float64]
"""Corners (n, 3, 3), metres."""


@dataclass(frozen=True, slots=True, eq=False)
class Fit:
    """A capsule: both ends of its axis (3,) and its radius, metres."""

    start_m: Vector
    end_m: Vector
    radius_m: float

    @property
    def volume_m3(self) -> float:
        """Return its volume."""
        length_m = float(np.linalg.norm(self.end_m - self.start_m))
        return math.pi * self.radius_m**2 * (length_m + 4.0 / 3.0 * self.radius_m)


@dataclass(frozen=True, slots=True, eq=False)
class _Part:
    """Some of the triangles, the capsule around them and the volume of their convex hull."""

    triangles: Triangles
    fit: Fit
    hull_m3: float


def fit_capsules(triangles: Triangles) -> list[Fit]:
    """Return capsules that together contain a surface, and the solid inside if it is closed.

    The surface is cut by planes where that makes the capsules smaller. Each capsule contains the
    convex hull of its part, so cutting leaves no gap.

    Args:
        triangles: At least one.
    """
    parts, final = [_part(triangles)], list[_Part]()
    while parts and len(parts) + len(final) < _MOST_CAPSULES:
        together = [*parts, *final]
        if sum(p.fit.volume_m3 for p in together) <= _TIGHT * sum(p.hull_m3 for p in together):
            break
        worst = max(parts, key=lambda part: part.fit.volume_m3 - part.hull_m3)
        parts.remove(worst)
        halves = _best_halves(worst)
        if halves:
            parts.extend(halves)
        else:
            final.append(worst)
    return [part.fit for part in (*parts, *final)]


def _part(triangles: Triangles) -> _Part:
    points, hull_m3 = _hull(triangles.reshape(-1, 3))
    return _Part(triangles, _tightest(points), hull_m3)


def _best_halves(part: _Part) -> list[_Part]:
    """Return the two parts of the cut that leaves the smallest capsules; none if none helps."""
    points = part.triangles.reshape(-1, 3)
    best, least_m3 = list[_Part](), (1.0 - _GAIN) * part.fit.volume_m3
    for axis in (*np.eye(3), _main_axis(points)):
        along = points @ axis
        halves = _cut(part.triangles, axis, 0.5 * (along.min() + along.max()))
        if all(len(half) for half in halves):
            found = [_part(half) for half in halves]
            volume_m3 = sum(half.fit.volume_m3 for half in found)
            if volume_m3 < least_m3:
                best, least_m3 = found, volume_m3
    return best


def _cut(triangles: Triangles, axis: Vector, at_m: float) -> tuple[Triangles, Triangles]:
    """Return the triangles on both sides of a plane; those that cross it are cut in three."""
    side = triangles @ axis - at_m
    above, below = (side >= 0.0).all(axis=1), (side < 0.0).all(axis=1)
    crossing, side = triangles[~above & ~below], side[~above & ~below]
    lone_above = (side >= 0.0).sum(axis=1) == 1
    furthest: list[NDArray[np.intp]] = [side.argmin(axis=1), side.argmax(axis=1)]
    turned = (np.choose(lone_above, furthest)[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(crossing, turned[:, :, None], axis=1).transpose(1, 0, 2)
    s_a, s_b, s_c = np.take_along_axis(side, turned, axis=1).T[..., None]
    p, q = a + (b - a) * s_a / (s_a - s_b), a + (c - a) * s_a / (s_a - s_c)
    tips = np.stack([a, p, q], axis=1)
    feet = np.concatenate([np.stack([p, b, c], axis=1), np.stack([p, c, q], axis=1)])
    feet_above = np.tile(~lone_above, 2)
    return (
        np.concatenate([triangles[above], tips[lone_above], feet[feet_above]]),
        np.concatenate([triangles[below], tips[~lone_above], feet[~feet_above]]),
    )


def _hull(points: Matrix) -> tuple[Matrix, float]:
    """Return the corners (k, 3) and the volume of a convex hull; a flat one has none."""
    from scipy.spatial import ConvexHull, QhullError  # noqa: PLC0415

    try:
        hull = ConvexHull(points)
    except (QhullError, ValueError):
        return np.unique(points, axis=0), 0.0
    return points[hull.vertices], float(hull.volume)


def _tightest(points: Matrix) -> Fit:
    """Return the smallest capsule around points (n, 3) with one of some axes."""
    axes = (*np.eye(3), *_main_axes(points))
    return min((_around(points, axis) for axis in axes), key=lambda fit: fit.volume_m3)


def _main_axes(points: Matrix) -> Matrix:
    """Return the principal axes (3, 3) of points, one a row, the longest first."""
    return np.linalg.svd(points - points.mean(axis=0), full_matrices=True)[2]


def _main_axis(points: Matrix) -> Vector:
    return _main_axes(_hull(points)[0])[0]


def _around(points: Matrix, axis: Vector) -> Fit:
    """Return the capsule along an axis that contains points (n, 3)."""
    across = np.linalg.svd(axis[None])[2][1:]
    flat, along = points @ across.T, points @ axis
    centre = _circle(flat)
    away_m = np.linalg.norm(flat - centre, axis=1)
    radius_m = float(away_m.max()) + 1e-9
    cap_m = np.sqrt(np.maximum(radius_m**2 - away_m**2, 0.0))
    start, end = float((along + cap_m).min()), float((along - cap_m).max())
    if start > end:  # one ball contains them all
        start = end = 0.5 * (start + end)
    return Fit(centre @ across + start * axis, centre @ across + end * axis, radius_m)


def _circle(flat: Matrix) -> Vector:
    """Return nearly the centre (2,) of the smallest circle around points (Badoiu and Clarkson)."""
    centre = 0.5 * (flat.min(axis=0) + flat.max(axis=0))
    best, least_m = centre, math.inf
    for i in range(_CIRCLE_STEPS):
        away_m = np.linalg.norm(flat - centre, axis=1)
        furthest = int(away_m.argmax())
        if away_m[furthest] < least_m:
            best, least_m = centre, float(away_m[furthest])
        centre = centre + (flat[furthest] - centre) / (i + 2)
    return best

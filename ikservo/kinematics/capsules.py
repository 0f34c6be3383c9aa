"""Capsules, and how far two of them are apart: the simplest body with a length (lecture L18)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["Capsule", "capsule_distance", "segment_box_distance", "segment_distance"]


@dataclass(frozen=True, slots=True, eq=False)
class Capsule:
    """All points within a radius of a segment, fixed to a link.

    Attributes:
        link: Name of the link it moves with.
        start_m: One end of the segment (3,), link coordinates, metres.
        end_m: The other end (3,); a ball where it is the same.
        radius_m: The radius.
    """

    link: str
    start_m: Vector
    end_m: Vector
    radius_m: float

    def ends(self, T_world_link: Matrix) -> tuple[Vector, Vector]:
        """Return both ends (3,) in world coordinates, metres."""
        R, p = T_world_link[:3, :3], T_world_link[:3, 3]
        return R @ self.start_m + p, R @ self.end_m + p


def capsule_distance(
    a: tuple[Vector, Vector], radius_a_m: float, b: tuple[Vector, Vector], radius_b_m: float
) -> float:
    """Return the gap between two capsules given by their ends, metres; negative inside."""
    return segment_distance(*a, *b) - radius_a_m - radius_b_m


def segment_distance(p1: Vector, q1: Vector, p2: Vector, q2: Vector) -> float:
    """Return the distance between the segments p1 q1 and p2 q2, metres.

    The closest points are where the gradient of the squared distance over both parameters
    vanishes, or on an end; after Ericson, Real-Time Collision Detection, 5.1.9.
    """
    d1, d2, r = q1 - p1, q2 - p2, p1 - p2
    a, e, f = float(d1 @ d1), float(d2 @ d2), float(d2 @ r)
    s, t = _closest_parameters(a, e, f, float(d1 @ r), float(d1 @ d2))
    gap = r + s * d1 - t * d2
    return float(np.sqrt(gap @ gap))


def segment_box_distance(a: Vector, b: Vector, low_m: Vector, high_m: Vector) -> float:
    """Return the distance from the segment a b to an upright box, metres; 0 inside.

    The distance to a convex body is a convex function along the segment, so that a search by
    golden sections finds its least value.
    """
    low, high = 0.0, 1.0
    for _ in range(60):
        s, t = high - _GOLDEN * (high - low), low + _GOLDEN * (high - low)
        if _point_box_m(a + s * (b - a), low_m, high_m) <= _point_box_m(
            a + t * (b - a), low_m, high_m
        ):
            high = t
        else:
            low = s
    return _point_box_m(a + 0.5 * (low + high) * (b - a), low_m, high_m)


_GOLDEN = (5**0.5 - 1) / 2
_POINT_M2 = 1e-18


def _point_box_m(point: Vector, low_m: Vector, high_m: Vector) -> float:
    outside = np.maximum(np.maximum(low_m - point, point - high_m), 0.0)
    return float(np.sqrt(outside @ outside))


def _closest_parameters(a: float, e: float, f: float, c: float, b: float) -> tuple[float, float]:
    """Return where along each segment, 0 to 1, the closest points lie."""
    if a <= _POINT_M2:
        return 0.0, _unit(f / e) if e > _POINT_M2 else 0.0
    if e <= _POINT_M2:
        return _unit(-c / a), 0.0
    denominator = a * e - b * b
    # Parallel segments have no single closest pair; any start will do.
    s = _unit((b * f - c * e) / denominator) if denominator > 1e-12 * a * e else 0.0
    t = (b * s + f) / e
    if t < 0.0:
        return _unit(-c / a), 0.0
    if t > 1.0:
        return _unit((b - c) / a), 1.0
    return s, t


def _unit(x: float) -> float:
    return min(max(x, 0.0), 1.0)

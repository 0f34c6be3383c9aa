"""Capsules and the distances between segments (numpy reference)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector

_TINY = 1e-30


@dataclass(frozen=True, slots=True, eq=False)
class Capsule(FrozenArrays):
    """All points within a radius of a segment, fixed to a link.

    Attributes:
        link: Name of the link with which the capsule moves.
        start_m: One end of the segment (3,), link coordinates, metres.
        end_m: The other end (3,); for a sphere, the same point.
        radius_m: The radius.
    """

    link: str
    start_m: Vector
    end_m: Vector
    radius_m: float

    @property
    def length_m(self) -> float:
        """Length of the segment."""
        return float(np.linalg.norm(self.end_m - self.start_m))

    def ends(self, T_world_link: Matrix) -> tuple[Vector, Vector]:
        """Return both ends (…, 3) in world coordinates, metres, for poses (…, 4, 4)."""
        R, p = T_world_link[..., :3, :3], T_world_link[..., :3, 3]
        return R @ self.start_m + p, R @ self.end_m + p


def segment_distance(p1: Vector, q1: Vector, p2: Vector, q2: Vector) -> Vector:
    """Compute the distances (…) between segments p1 q1 and p2 q2, each end (…, 3), metres.

    The closest points are where the gradient of the squared distance over both parameters
    vanishes, or on an end; after Ericson, Real-Time Collision Detection, 5.1.9.
    """
    d1, d2, r = q1 - p1, q2 - p2, p1 - p2
    a, e, b = _row_dot(d1, d1), _row_dot(d2, d2), _row_dot(d1, d2)
    c, f = _row_dot(d1, r), _row_dot(d2, r)
    # Parallel segments and points do not have a single closest pair: any s can be the start.
    crossing = np.maximum(a * e - b * b, _TINY)
    s = _clamp_unit_interval((b * f - c * e) / crossing)
    t = _clamp_unit_interval((b * s + f) / np.maximum(e, _TINY))
    s = _clamp_unit_interval((b * t - c) / np.maximum(a, _TINY))
    gap = r + s[..., None] * d1 - t[..., None] * d2
    return np.sqrt(_row_dot(gap, gap))


def _row_dot(a: Vector, b: Vector) -> Vector:
    return np.einsum("...i,...i->...", a, b)


def _clamp_unit_interval(x: Vector) -> Vector:
    clipped: Vector = np.clip(x, 0.0, 1.0)
    return clipped

"""Rays: what a pixel sees, and where that meets planes and boxes."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ikservo.kinematics.arrays import Matrix, Vector, freeze_arrays

__all__ = ["Ray"]

_LEVEL = 1e-3  # a ray as level as that meets a level plane anywhere
_PARALLEL_TO_PLANE, _PARALLEL = 1e-9, 1e-12


@dataclass(frozen=True, slots=True, eq=False)
class Ray:
    """A half line, such as what a pixel sees.

    Attributes:
        origin_m: Its start (3,), metres.
        direction: A unit vector (3,).
    """

    origin_m: Vector
    direction: Vector

    def __post_init__(self) -> None:
        freeze_arrays(self)

    def at(self, distance_m: float) -> Vector:
        """Return the point (3,) at a distance along it."""
        return self.origin_m + distance_m * self.direction

    def intersect_plane(self, point_m: Vector, normal: Vector) -> Vector | None:
        """Compute the intersection (3,) with a plane; None if it is not met."""
        slope = float(self.direction @ normal)
        if abs(slope) < _PARALLEL_TO_PLANE:
            return None
        distance_m = float((point_m - self.origin_m) @ normal) / slope
        return None if distance_m < 0.0 else self.at(distance_m)

    def distance_to_level_m(self, z_m: float) -> float:
        """Return the distance to the level plane at z, metres; infinite if it is not met."""
        if abs(float(self.direction[2])) < _LEVEL:
            return math.inf
        distance_m = float((z_m - self.origin_m[2]) / self.direction[2])
        return distance_m if distance_m > 0.0 else math.inf

    def distance_to_box_m(self, R: Matrix, centre_m: Vector, half_m: Vector) -> float:
        """Return the distance to a box, metres; infinite if it is not met, or from inside.

        Args:
            R: Its axes as columns (3, 3).
            centre_m: Its centre (3,).
            half_m: Half of its sides (3,).
        """
        origin, along = (self.origin_m - centre_m) @ R, self.direction @ R
        along = np.where(np.abs(along) < _PARALLEL, _PARALLEL, along)
        one, other = (-half_m - origin) / along, (half_m - origin) / along
        enter_m = float(np.minimum(one, other).max())
        leave_m = float(np.maximum(one, other).min())
        return enter_m if 0.0 < enter_m <= leave_m else math.inf

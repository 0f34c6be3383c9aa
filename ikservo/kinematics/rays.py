"""Rays, such as the line of sight of a pixel, and their intersections with planes and obstacles."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector
from ikservo.kinematics.packed import IS_CYLINDER, ROUNDING

_LEVEL = 1e-3  # a ray with a smaller slope has no reliable intersection with a horizontal plane
_PARALLEL_TO_PLANE = 1e-9  # a ray with this slope meets no plane
_PARALLEL = 1e-12  # smallest slope to divide by
_TOUCHES_M = 1e-7  # a ray this near to a shape counts as touching it
_MOST_STEPS = 500  # maximum number of steps along a ray


@dataclass(frozen=True, slots=True, eq=False)
class Ray(FrozenArrays):
    """A half line, such as the line of sight of a pixel: origin (3,), unit direction (3,)."""

    origin_m: Vector
    direction: Vector

    def at(self, distance_m: float) -> Vector:
        """Return the point (3,) at a distance along the ray."""
        return self.origin_m + distance_m * self.direction

    def intersect_plane(self, point_m: Vector, normal: Vector) -> Vector | None:
        """Compute the intersection (3,) with a plane; None if the ray misses it."""
        slope = float(self.direction @ normal)
        if abs(slope) < _PARALLEL_TO_PLANE:
            return None
        distance_m = float((point_m - self.origin_m) @ normal) / slope
        return None if distance_m < 0.0 else self.at(distance_m)

    def distance_to_level_m(self, z_m: float) -> float:
        """Return the distance to the horizontal plane at z, metres; infinite if the ray misses."""
        if abs(float(self.direction[2])) < _LEVEL:
            return math.inf
        distance_m = float((z_m - self.origin_m[2]) / self.direction[2])
        return distance_m if distance_m > 0.0 else math.inf

    def distance_to_box_m(self, R: Matrix, centre_m: Vector, half_m: Vector) -> float:
        """Return the distance to a box, metres; infinite if the ray misses it or starts inside.

        ``R`` has the box's axes as columns, ``half_m`` (3,) is half of the lengths of its sides.
        """
        origin, along = (self.origin_m - centre_m) @ R, self.direction @ R
        along = np.where(np.abs(along) < _PARALLEL, _PARALLEL, along)
        first, second = (-half_m - origin) / along, (half_m - origin) / along
        enter_m = float(np.minimum(first, second).max())
        leave_m = float(np.maximum(first, second).min())
        return enter_m if 0.0 < enter_m <= leave_m else math.inf

    def distance_to_thing_m(self, row: Vector) -> float:
        """Return the distance to a box, cylinder or sphere, metres; infinite if the ray misses it.

        From the point where the ray enters the bounding box, each step is as long as the distance
        to the surface and cannot pass it (sphere tracing). A ray that starts inside misses.

        Args:
            row: The box, cylinder or sphere (17,); see ``kinematics.packed``.
        """
        R, centre_m, half_m = row[:9].reshape(3, 3), row[9:12], row[12:15]
        around_m, origin_m = half_m + row[ROUNDING], (self.origin_m - centre_m) @ R
        if _away_m(origin_m, half_m, row) <= 0.0:
            return math.inf
        is_in_box = bool((np.abs(origin_m) <= around_m).all())
        walked_m = 0.0 if is_in_box else self.distance_to_box_m(R, centre_m, around_m)
        end_m = walked_m + 2.0 * float(np.linalg.norm(around_m))
        for _ in range(_MOST_STEPS):
            if not walked_m <= end_m < math.inf:
                return math.inf
            away_m = _away_m((self.at(walked_m) - centre_m) @ R, half_m, row)
            if away_m < _TOUCHES_M:
                return walked_m
            walked_m += away_m
        return math.inf  # the ray grazes the shape


def _away_m(point_m: Vector, half_m: Vector, row: Vector) -> float:
    """Compute the distance [m] from a shape's surface to a point (3,) in the shape's axes."""
    x, y, z = np.abs(point_m)
    beyond = np.array([x, y, z]) - half_m
    if row[IS_CYLINDER]:
        beyond = np.array([math.hypot(x, y) - half_m[0], z - half_m[2]])
    return float(np.linalg.norm(np.maximum(beyond, 0.0)) - row[ROUNDING])

"""Lines of sight (lecture L15)."""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.kinematics.se3 import Vector

__all__ = ["Ray"]

_PARALLEL = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Ray:
    """A half line from the eye into the world.

    Attributes:
        origin_m: Where it starts (3,), metres.
        direction: Where it goes, a unit vector (3,).
    """

    origin_m: Vector
    direction: Vector

    def at(self, way_m: float) -> Vector:
        """Return the point (3,) that far along."""
        return self.origin_m + way_m * self.direction

    def meets_plane(self, point_m: Vector, normal: Vector) -> Vector | None:
        """Return where it meets a plane (3,); None where it runs along it or away from it."""
        slope = float(self.direction @ normal)
        if abs(slope) < _PARALLEL:
            return None
        way_m = float((point_m - self.origin_m) @ normal) / slope
        return None if way_m < 0.0 else self.at(way_m)

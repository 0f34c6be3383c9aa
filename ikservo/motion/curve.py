"""What a way of joints is before anybody says how fast it is gone through."""

from __future__ import annotations

from typing import Protocol

from ikservo.kinematics.se3 import Vector

__all__ = ["Curve"]


class Curve(Protocol):
    """A smooth curve of n values over a distance, which may be metres, radians or any measure."""

    @property
    def length(self) -> float:
        """Return the distance at its end; it begins at 0."""
        ...

    def at(self, distance: float) -> tuple[Vector, Vector, Vector]:
        """Return the point, its slope and its bend (n,): the curve and two derivatives."""
        ...

    def steepest(self, begin: float, end: float) -> tuple[Vector, Vector, Vector]:
        """Return what slope, bend and twist (n,) are at most, as magnitudes, in a stretch of it.

        The twist is the third derivative.
        """
        ...

"""A smooth curve through joint vectors, with its first and second derivative."""

from __future__ import annotations

import numpy as np

from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["Spline"]


class Spline:
    """The cubic spline through points at even distances (scipy's, not-a-knot ends).

    Args:
        distances: Where the points stand (n,), increasing from 0.
        points: The points (n, dof).
    """

    def __init__(self, distances: Vector, points: Matrix) -> None:
        from scipy.interpolate import CubicSpline  # noqa: PLC0415  # half a second to import

        self.length = float(distances[-1])
        self._curve = CubicSpline(distances, points)

    def at(self, distance: float) -> tuple[Vector, Vector, Vector]:
        """Return the point, its slope and its bend (dof,) at a distance."""
        inside = min(max(distance, 0.0), self.length)
        q, slope, bend = (np.asarray(self._curve(inside, order)) for order in (0, 1, 2))
        return q, slope, bend

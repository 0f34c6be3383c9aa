"""A smooth curve through joint vectors, with its derivatives."""

from __future__ import annotations

import numpy as np

from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["Spline"]

_VANISHING = 1e-300


class Spline:
    """The cubic spline through points at even distances (scipy's, not-a-knot ends).

    Args:
        distances: Where the points stand (k,), increasing from 0; at least four.
        points: The points (k, n).

    Attributes:
        distances: Where its points stand.
        length: Where the last one stands.
    """

    def __init__(self, distances: Vector, points: Matrix) -> None:
        from scipy.interpolate import CubicSpline  # noqa: PLC0415  # half a second to import

        self.length = float(distances[-1])
        self.distances = distances
        self._curve = CubicSpline(distances, points)
        self._slopes, self._bends, self._twists = _magnitudes(
            np.asarray(self._curve.c, dtype=np.float64), np.diff(distances)[:, None]
        )

    def at(self, distance: float) -> tuple[Vector, Vector, Vector]:
        """Return the point, its slope and its bend (n,) at a distance."""
        inside = min(max(distance, 0.0), self.length)
        q, slope, bend = (np.asarray(self._curve(inside, order)) for order in (0, 1, 2))
        return q, slope, bend

    def points(self, distances: Vector) -> Matrix:
        """Return the points (k, n) at distances (k,)."""
        return np.asarray(self._curve(distances), dtype=np.float64)

    def steepest(self, begin: float, end: float) -> tuple[Vector, Vector, Vector]:
        """Return what slope, bend and twist (n,) are at most between two distances."""
        first = max(int(np.searchsorted(self.distances, begin, side="right")) - 1, 0)
        last = max(int(np.searchsorted(self.distances, end, side="left")), first + 1)
        pieces = slice(first, last)
        return (
            self._slopes[pieces].max(axis=0),
            self._bends[pieces].max(axis=0),
            self._twists[pieces].max(axis=0),
        )


def _magnitudes(c: Matrix, width: Matrix) -> tuple[Matrix, Matrix, Matrix]:
    """Return the largest slope, bend and twist (k - 1, n) of cubics c₀t³ + c₁t² + c₂t + c₃."""
    summit = np.clip(-c[1] / (3.0 * np.where(c[0] == 0.0, _VANISHING, c[0])), 0.0, width)
    slopes = [np.abs((3.0 * c[0] * t + 2.0 * c[1]) * t + c[2]) for t in (0.0, summit, width)]
    bends = [np.abs(6.0 * c[0] * t + 2.0 * c[1]) for t in (0.0, width)]
    return np.max(slopes, axis=0), np.max(bends, axis=0), np.abs(6.0 * c[0])

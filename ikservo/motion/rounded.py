"""A way from point to point on straight lines, its corners rounded."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ikservo.errors import BadValueError
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["Rounded"]

# Nearer than this two points are one.
_SAME = 1e-9


class Rounded:
    """Straight lines through points in n dimensions, with a blend instead of each corner.

    In a blend the slope goes over from one line's direction to the other's by the polynomial
    3x² - 2x³, so that slope and bend are continuous. The curve then passes each corner at no more
    than 3/8 of the blend, stays inside the box of its points, and is never longer than the lines.

    Args:
        points: The points (k, n).
        blends: At which distance before each of the k - 2 inner points the line is left; half of
            a line at most is used.
        order: The norm that measures distances: 2 for metres in space, inf for joints.

    Raises:
        BadValueError: A blend is not positive.
    """

    def __init__(self, points: Matrix, blends: Sequence[float], order: float = 2) -> None:
        if not all(0.0 < blend < np.inf for blend in blends):
            raise BadValueError("The blend", list(blends), "a positive distance")
        points, blends = _apart(points, blends, order)
        self._pieces = list(_pieces(points, blends, order))
        self._begins = [piece.begin for piece in self._pieces]
        self.length = self._pieces[-1].end if self._pieces else 0.0
        self._start = points[0]

    @property
    def marks(self) -> list[float]:
        """Return the distances at which blends begin and end, and both ends."""
        return [*self._begins, self.length]

    def way(self) -> float:
        """Return how long the curve itself is: corners that are cut make it shorter."""
        looks = np.linspace(0.0, self.length, 2 + 64 * len(self._pieces))
        points = np.array([self.at(distance)[0] for distance in looks.tolist()])
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())

    def at(self, distance: float) -> tuple[Vector, Vector, Vector]:
        """Return the point, its slope and its bend (n,) at a distance."""
        if not self._pieces:
            return self._start, np.zeros_like(self._start), np.zeros_like(self._start)
        inside = min(max(distance, 0.0), self.length)
        return self._pieces[max(bisect_right(self._begins, inside) - 1, 0)].at(inside)

    def steepest(self, begin: float, end: float) -> tuple[Vector, Vector, Vector]:
        """Return what slope, bend and twist (n,) are at most between two distances."""
        inside = [p.steepest() for p in self._pieces if p.begin < end and p.end > begin]
        slopes, bends, twists = zip(*inside, strict=True)
        return np.max(slopes, axis=0), np.max(bends, axis=0), np.max(twists, axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class _Piece:
    """A line, or a blend of two: its slope goes from one direction (n,) to the other."""

    begin: float
    end: float
    point: Vector
    slope: Vector
    next_slope: Vector

    def at(self, distance: float) -> tuple[Vector, Vector, Vector]:
        width, turn = self.end - self.begin, self.next_slope - self.slope
        x = (distance - self.begin) / width
        return (
            self.point + width * (x * self.slope + x**3 * (1.0 - 0.5 * x) * turn),
            self.slope + x * x * (3.0 - 2.0 * x) * turn,
            6.0 * x * (1.0 - x) / width * turn,
        )

    def steepest(self) -> tuple[Vector, Vector, Vector]:
        width, turn = self.end - self.begin, np.abs(self.next_slope - self.slope)
        slope = np.maximum(np.abs(self.slope), np.abs(self.next_slope))
        return slope, 1.5 / width * turn, 6.0 / width**2 * turn


def _apart(points: Matrix, blends: Sequence[float], order: float) -> tuple[Matrix, list[float]]:
    """Leave out points that are where the one before is, and their blends."""
    kept, kept_blends = [points[0]], list[float]()
    radii = [0.0, *blends, 0.0]
    for point, blend in zip(points[1:], radii[1:], strict=True):
        if float(np.linalg.norm(point - kept[-1], order)) > _SAME:
            kept.append(point)
            kept_blends.append(blend)
    return np.array(kept), kept_blends[:-1]


def _pieces(points: Matrix, blends: Sequence[float], order: float) -> list[_Piece]:
    legs = [b - a for a, b in pairwise(points)]
    lengths = [float(np.linalg.norm(leg, order)) for leg in legs]
    slopes = [leg / length for leg, length in zip(legs, lengths, strict=True)]
    cuts = [min(r, 0.5 * a, 0.5 * b) for r, (a, b) in zip(blends, pairwise(lengths), strict=True)]
    pieces: list[_Piece] = []
    gone = 0.0
    for i, (slope, length) in enumerate(zip(slopes, lengths, strict=True)):
        before, after = (0.0, *cuts)[i], (*cuts, 0.0)[i]
        straight = length - before - after
        if straight > _SAME:
            pieces.append(_Piece(gone, gone + straight, points[i] + before * slope, slope, slope))
            gone += straight
        if after > 0.0:
            entry = points[i + 1] - after * slope
            pieces.append(_Piece(gone, gone + 2.0 * after, entry, slope, slopes[i + 1]))
            gone += 2.0 * after
    return pieces

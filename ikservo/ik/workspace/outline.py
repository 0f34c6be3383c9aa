"""The border of a set of square cells as closed polygons."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ikservo.kinematics.se3 import Matrix

__all__ = ["outline"]

Corner = tuple[int, int]

# The four sides of a cell, walked with the cell on the left: the neighbour behind the side, and
# the corners between which the side runs.
_SIDES = (
    ((0, -1), (0, 0), (1, 0)),
    ((1, 0), (1, 0), (1, 1)),
    ((0, 1), (1, 1), (0, 1)),
    ((-1, 0), (0, 1), (0, 0)),
)


def outline(mask: NDArray[np.bool_]) -> tuple[Matrix, ...]:
    """Return closed polygons (k, 2) around the True cells of (nu, nv), in cells.

    The set is on the left: islands run counterclockwise, holes clockwise. The first corner is
    not repeated, and no corner lies on a straight line between its neighbours.
    """
    ways = _border(mask)
    loops: list[Matrix] = []
    while ways:
        loops.append(_without_straight_corners(_walk(ways)))
    return tuple(loops)


def _border(mask: NDArray[np.bool_]) -> dict[Corner, list[Corner]]:
    """Return where the border leads from each corner."""
    padded = np.pad(mask, 1)
    ways: dict[Corner, list[Corner]] = {}
    for (du, dv), start, end in _SIDES:
        open_side = mask & ~np.roll(padded, (-du, -dv), (0, 1))[1:-1, 1:-1]
        for u, v in np.argwhere(open_side).tolist():
            ways.setdefault((u + start[0], v + start[1]), []).append((u + end[0], v + end[1]))
    return ways


def _walk(ways: dict[Corner, list[Corner]]) -> list[Corner]:
    """Take one loop out of the border."""
    first = at = min(ways)
    loop: list[Corner] = []
    while not loop or at != first:
        loop.append(at)
        onward = ways[at]
        following = onward.pop()
        if not onward:
            del ways[at]
        at = following
    return loop


def _without_straight_corners(loop: list[Corner]) -> Matrix:
    corners = np.array(loop, dtype=np.float64)
    turned = (np.roll(corners, -1, axis=0) - corners) != (corners - np.roll(corners, 1, axis=0))
    return corners[turned.any(axis=1)]

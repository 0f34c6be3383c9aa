"""What can be seen and grabbed: capsules, balls and triangles in the coordinates of their link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.se3 import Matrix
from ikservo.model import Model
from ikservo.model.shell import capsules_of

__all__ = [
    "CAPSULE",
    "TRIANGLE",
    "WIDTH",
    "boxes_around",
    "capsule_rows",
    "capsules_of",
    "objects_of",
    "shapes_of",
    "triangle_rows",
]

# A primitive is a row: what it is, then two points and a radius, or three corners.
WIDTH = 10
CAPSULE, TRIANGLE = 0.0, 1.0
_KIND, _A, _B, _C, _RADIUS = 0, slice(1, 4), slice(4, 7), slice(7, 10), 7


def shapes_of(capsules: Sequence[Capsule]) -> Mapping[str, Matrix]:
    """Return the primitives (n, WIDTH) of each link."""
    links = dict.fromkeys(capsule.link for capsule in capsules)
    return {
        link: capsule_rows(
            np.array([c.start_m for c in capsules if c.link == link]),
            np.array([c.end_m for c in capsules if c.link == link]),
            np.array([c.radius_m for c in capsules if c.link == link]),
        )
        for link in links
    }


def capsule_rows(starts_m: Matrix, ends_m: Matrix, radii_m: Matrix) -> Matrix:
    """Return capsules (n, WIDTH) from (n, 3), (n, 3) and (n,); balls where both ends are one."""
    rows = np.zeros((len(starts_m), WIDTH))
    rows[:, _KIND], rows[:, _RADIUS] = CAPSULE, radii_m
    rows[:, _A], rows[:, _B] = starts_m, ends_m
    return rows


def triangle_rows(corners_m: Matrix) -> Matrix:
    """Return triangles (n, WIDTH) from their corners (n, 3, 3); both sides can be seen."""
    rows = np.zeros((len(corners_m), WIDTH))
    rows[:, _KIND] = TRIANGLE
    rows[:, _A], rows[:, _B], rows[:, _C] = corners_m[:, 0], corners_m[:, 1], corners_m[:, 2]
    return rows


def objects_of(model: Model) -> Mapping[str, Matrix]:
    """Return the primitives (n, WIDTH) of each box that the arm keeps out of, base frame."""
    return {box.name: _box_rows(np.array([box.low_m, box.high_m])) for box in model.keep_out}


def _box_rows(ends_m: Matrix) -> Matrix:
    """Return the twelve triangles of an upright box from its low and high corner (2, 3)."""
    corners = np.array([[ends_m[index, axis] for axis, index in enumerate(each)] for each in _BITS])
    halves = [half for a, b, c, d in _FACES for half in ((a, b, c), (a, c, d))]
    return triangle_rows(corners[halves])


_BITS = tuple(np.ndindex(2, 2, 2))
# The corners of a box's faces, one after the other round each.
_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))


def boxes_around(rows: Matrix) -> Matrix:
    """Return the upright box (n, 6) around each primitive: low corner, high corner."""
    a, b = rows[:, _A], rows[:, _B]
    low, high = np.minimum(a, b), np.maximum(a, b)
    is_triangle = rows[:, _KIND] == TRIANGLE
    c = np.where(is_triangle[:, None], rows[:, _C], a)
    more = np.where(is_triangle, 0.0, rows[:, _RADIUS])[:, None]
    return np.hstack([np.minimum(low, c) - more, np.maximum(high, c) + more])

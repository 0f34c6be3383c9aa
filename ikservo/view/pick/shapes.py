"""What can be seen and grabbed: capsules, balls and triangles in the coordinates of their link."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.se3 import Matrix
from ikservo.model import Model
from ikservo.model.shell import capsules_around

__all__ = [
    "CAPSULE",
    "TRIANGLE",
    "WIDTH",
    "boxes_around",
    "capsule_rows",
    "capsules_of",
    "shapes_of",
    "triangle_rows",
]

# A primitive is a row: what it is, then two points and a radius, or three corners.
WIDTH = 10
CAPSULE, TRIANGLE = 0.0, 1.0
_KIND, _A, _B, _C, _RADIUS = 0, slice(1, 4), slice(4, 7), slice(7, 10), 7


def capsules_of(model: Model) -> list[Capsule]:
    """Return the capsules around every shape of an arm; the guard knows its body by the same."""
    return [
        capsule
        for link in model.urdf.links
        for shape in link.collisions
        for capsule in capsules_around(link.name, shape)
    ]


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


def boxes_around(rows: Matrix) -> Matrix:
    """Return the upright box (n, 6) around each primitive: low corner, high corner."""
    a, b = rows[:, _A], rows[:, _B]
    low, high = np.minimum(a, b), np.maximum(a, b)
    is_triangle = rows[:, _KIND] == TRIANGLE
    c = np.where(is_triangle[:, None], rows[:, _C], a)
    more = np.where(is_triangle, 0.0, rows[:, _RADIUS])[:, None]
    return np.hstack([np.minimum(low, c) - more, np.maximum(high, c) + more])

"""The collision shapes of a URDF as boxes in frames of their own, with points on the surface."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass
from xml.etree.ElementTree import Element

import numpy as np

from servosim.urdf_numbers import Matrix, numbers, origin

__all__ = ["Shape", "shapes_of"]

SPACING_M = 0.02  # of the points on a surface
# A cylinder counts as the box whose square section has the same area; a sphere as the inner cube.
SQUARE, CUBE = math.sqrt(math.pi) / 2.0, 1.0 / math.sqrt(3.0)


@dataclass(frozen=True, slots=True)
class Shape:
    """A box.

    Attributes:
        body: Index of the moving joint it is fixed behind, -1 at the base.
        T: Its frame in that joint's, its centre the origin.
        half_m: Half its edges (3,).
        points_m: Points on its surface (k, 3), in its own frame.
    """

    body: int
    T: Matrix
    half_m: Matrix
    points_m: Matrix


def shapes_of(link: Element, body: int, T: Matrix) -> list[Shape]:
    """Return the boxes, cylinders and spheres of a link; meshes are left out.

    Args:
        link: The element.
        body: Index of the moving joint it is fixed behind.
        T: The link's frame in that joint's.
    """
    found: list[Shape] = []
    for collision in link.findall("collision"):
        half_m = _half_m(collision)
        if half_m is not None:
            found.append(Shape(body, T @ origin(collision), half_m, _surface(half_m)))
    return found


def _half_m(collision: Element) -> Matrix | None:
    box, cylinder, sphere = (
        collision.find(f"geometry/{kind}") for kind in ("box", "cylinder", "sphere")
    )
    if box is not None:
        return np.array(numbers(box, "size", (0.0, 0.0, 0.0))) / 2.0
    if cylinder is not None:
        radius_m = SQUARE * float(cylinder.attrib["radius"])
        return np.array([radius_m, radius_m, float(cylinder.attrib["length"]) / 2.0])
    if sphere is not None:
        return np.full(3, CUBE * float(sphere.attrib["radius"]))
    return None


def _surface(half_m: Matrix) -> Matrix:
    """Return points of a grid on the surface (k, 3), corners included."""
    halves: list[float] = half_m.tolist()
    edges: list[list[float]] = [
        np.linspace(-h, h, 2 + int(2.0 * h / SPACING_M)).tolist() for h in halves
    ]
    grid = np.array(list(itertools.product(*edges)))
    return grid[(np.abs(np.abs(grid) - half_m) < 1e-9).any(axis=1)]

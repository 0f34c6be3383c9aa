"""The answer: which cells of a grid the tip can be in."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ikservo.ik.workspace.grid import Grid
from ikservo.ik.workspace.outline import outline
from ikservo.kinematics import finite_vector
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["Workspace"]


@dataclass(frozen=True, slots=True, eq=False)
class Workspace:
    """The reachable cells of a slice or a volume.

    A cell counts as reachable when a tip was found in it, or when the reachable point nearest
    its middle is in it; so the true border runs through the outermost cells.

    Attributes:
        grid: The cells.
        reachable: Whether the tip can be in each cell; the grid's shape.
        is_slice: Whether the grid is one sheet of cells in a plane.
    """

    grid: Grid
    reachable: NDArray[np.bool_]
    is_slice: bool

    @property
    def count(self) -> int:
        """Return how many cells are reachable."""
        return int(self.reachable.sum())

    @property
    def size(self) -> float:
        """Return the area [m²] of a slice or the volume [m³], all reachable cells in full."""
        return self.count * self.grid.cell_m ** (2 if self.is_slice else 3)

    @property
    def extent_m(self) -> tuple[Vector, Vector] | None:
        """Return the corners (3,) of the box around the reachable cells, in the grid's frame.

        None where no cell is reachable.
        """
        cells = np.argwhere(self.reachable)
        if not len(cells):
            return None
        corner, cell_m = self.grid.first_m, self.grid.cell_m
        return corner + cells.min(axis=0) * cell_m, corner + (cells.max(axis=0) + 1) * cell_m

    def contains(self, point_m: ArrayLike) -> bool:
        """Return whether a point (3,) of the base frame lies in a reachable cell.

        A point farther than half a cell from the plane of a slice lies in no cell of it.
        """
        return bool(self.contains_each([finite_vector(point_m, 3, "point_m")])[0])

    def contains_each(self, points_m: ArrayLike) -> NDArray[np.bool_]:
        """Return for each point (n, 3) of the base frame whether it is in a reachable cell."""
        cells, exist = self.grid.cells_of(points_m)
        return np.logical_and(exist, self.reachable[tuple(cells.T)])

    def mask(self, along: int = 2) -> NDArray[np.bool_]:
        """Return what is reachable as seen along a grid axis; of a volume that is its shadow."""
        return np.any(self.reachable, axis=along)

    def outline(self, along: int = 2) -> tuple[Matrix, ...]:
        """Return the borders of ``mask`` as closed polygons (k, 2) along its axes, metres.

        Islands run counterclockwise, holes clockwise.
        """
        corner = np.delete(self.grid.first_m, along)
        return tuple(corner + self.grid.cell_m * loop for loop in outline(self.mask(along)))

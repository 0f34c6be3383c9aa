"""Equal cubes laid out along three axes; a slice is a grid one cube thick."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ikservo.errors import BadValueError
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["Cells", "Grid", "grid_around", "slice_around"]

Cells = NDArray[np.intp]
"""Whole-numbered places (n, 3) of cells in a grid."""

# A slice or a volume of more cells than this is a slip of the unit, not a wish.
_MOST_CELLS = 5_000_000


@dataclass(frozen=True, slots=True, eq=False)
class Grid:
    """Cubes along the axes u, v, w of a frame.

    Attributes:
        T_world_grid: The frame (4, 4) whose axes the cubes are laid along.
        first_m: The outer corner (3,) of cell (0, 0, 0) in that frame, metres.
        shape: How many cells along u, v and w.
        cell_m: The edge of a cell.
    """

    T_world_grid: Matrix
    first_m: Vector
    shape: tuple[int, int, int]
    cell_m: float

    def to_grid(self, points_m: ArrayLike) -> Matrix:
        """Return points (n, 3) of the base frame in the grid's own frame."""
        T = self.T_world_grid
        local: Matrix = (np.asarray(points_m, dtype=np.float64) - T[:3, 3]) @ T[:3, :3]
        return local

    def to_world(self, local_m: ArrayLike) -> Matrix:
        """Return points (n, 3) of the grid's frame in the base frame."""
        T = self.T_world_grid
        world: Matrix = np.asarray(local_m, dtype=np.float64) @ T[:3, :3].T + T[:3, 3]
        return world

    def cells_of(self, points_m: ArrayLike) -> tuple[Cells, NDArray[np.bool_]]:
        """Return the cells (n, 3) that points (n, 3) lie in, and which of them exist (n,)."""
        places = np.floor((self.to_grid(points_m) - self.first_m) / self.cell_m)
        exist: NDArray[np.bool_] = np.all((places >= 0) & (places < self.shape), axis=1)
        return np.where(exist[:, None], places, 0).astype(np.intp), exist

    def centres(self, cells: Cells) -> Matrix:
        """Return the middles (n, 3) of cells in the base frame, metres."""
        return self.to_world(self.first_m + (cells + 0.5) * self.cell_m)


def grid_around(points_m: Matrix, cell_m: float) -> Grid:
    """Lay cubes along the base frame's axes, with room to spare around the points (n, 3)."""
    frame = np.eye(4)
    lower, upper = _box(points_m, frame)
    return _grid(frame, lower, upper, cell_m)


def slice_around(points_m: Matrix, T_world_plane: Matrix, cell_m: float) -> Grid:
    """Lay one sheet of cubes whose middles are in the plane w = 0 of a frame (4, 4)."""
    lower, upper = _box(points_m, T_world_plane)
    lower[2] = upper[2] = 0.0
    return _grid(T_world_plane, lower, upper, cell_m)


def _box(points_m: Matrix, frame: Matrix) -> tuple[Vector, Vector]:
    """Return corners (3,) of a box around the points: samples never meet the very ends."""
    local = Grid(frame, np.zeros(3), (1, 1, 1), 1.0).to_grid(points_m)
    lower, upper = local.min(axis=0), local.max(axis=0)
    spare = 0.05 * (upper - lower)
    return lower - spare, upper + spare


def _grid(frame: Matrix, lower: Vector, upper: Vector, cell_m: float) -> Grid:
    """Fill the box with an odd number of cells each way, so that its middle is a cell's middle.

    What is flat, such as the reach of an arm in one plane, then lies in one sheet of cells.
    """
    if not (math.isfinite(cell_m) and cell_m > 0):
        raise BadValueError("cell_m", cell_m, "a length above 0")
    half = np.ceil((upper - lower) / (2 * cell_m) - 1e-9)
    u, v, w = (2 * int(n) + 1 for n in half)
    if u * v * w > _MOST_CELLS:
        raise BadValueError("cell_m", f"{cell_m:g} m, {u * v * w} cells", "larger cells")
    first = 0.5 * (lower + upper) - (half + 0.5) * cell_m
    return Grid(frame, first, (u, v, w), cell_m)

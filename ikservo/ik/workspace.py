"""Workspace of an arm: reachable points, sampled inside the joint limits."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ikservo.ik.batch import solve_batch
from ikservo.ik.prepare import quasi_random_points
from ikservo.ik.problem import Options
from ikservo.ik.workspace_grid import Cells, VoxelGrid, boundary_polygons, grid_around, slice_around
from ikservo.kinematics import Chain, finite_vector
from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector


@dataclass(frozen=True, slots=True, eq=False)
class Workspace(FrozenArrays):
    """The reachable cells of a slice or a volume.

    A cell counts as reachable if a posture with the tip in it was found, or if the reachable point
    nearest its middle is in it; the true border therefore runs through the outermost cells.

    Attributes:
        grid: The cells.
        reachable: Whether the tip can be in each cell; the grid's shape.
        is_slice: Whether the grid is one layer of cells in a plane.
    """

    grid: VoxelGrid
    reachable: NDArray[np.bool_]
    is_slice: bool

    @property
    def count(self) -> int:
        """Number of reachable cells."""
        return int(self.reachable.sum())

    @property
    def size(self) -> float:
        """Area [m²] of a slice or volume [m³] of all reachable cells, each counted in full."""
        return self.count * self.grid.cell_m ** (2 if self.is_slice else 3)

    @property
    def extent_m(self) -> tuple[Vector, Vector] | None:
        """The corners (3,) of the box around the reachable cells, in the grid's frame.

        The value is None if no cell is reachable.
        """
        cells = np.argwhere(self.reachable)
        if not len(cells):
            return None
        corner, cell_m = self.grid.first_m, self.grid.cell_m
        return corner + cells.min(axis=0) * cell_m, corner + (cells.max(axis=0) + 1) * cell_m

    def contains(self, point_m: ArrayLike) -> bool:
        """Check whether a point (3,) of the base frame is in a reachable cell.

        A point further than half a cell from the plane of a slice is outside all of its cells.
        """
        return bool(self.contains_many([finite_vector(point_m, 3, "point_m")])[0])

    def contains_many(self, points_m: ArrayLike) -> NDArray[np.bool_]:
        """Check whether each point (n, 3) of the base frame is in a reachable cell."""
        cells, exist = self.grid.cells_of(points_m)
        return np.logical_and(exist, self.reachable[tuple(cells.T)])

    def mask(self, along: int = 2) -> NDArray[np.bool_]:
        """Return the reachable cells as seen along a grid axis; a volume is projected along it."""
        return np.any(self.reachable, axis=along)

    def outline(self, along: int = 2) -> tuple[Matrix, ...]:
        """Compute the borders of ``mask`` as closed polygons (k, 2) in the mask's axes, metres.

        Islands run counterclockwise, holes clockwise.
        """
        corner = np.delete(self.grid.first_m, along)
        return tuple(
            corner + self.grid.cell_m * loop for loop in boundary_polygons(self.mask(along))
        )


def quasi_random_joints(chain: Chain, count: int) -> Matrix:
    """Return joint vectors (count, dof) inside the limits; unlimited joints are within ±π.

    They do not cluster, see ``quasi_random_points``.
    """
    evenly = quasi_random_points(count + 1, chain.dof)[1:]
    low = np.maximum(chain.lower_rad, -math.pi)
    high = np.minimum(chain.upper_rad, math.pi)
    return chain.clip(low + (high - low) * evenly)


def tip_positions(chain: Chain, q: Matrix) -> Matrix:
    """Return the tip positions (n, 3), metres, of joint vectors (n, dof)."""
    return chain.forward(q)[:, :3, 3]


Clear = Callable[[Matrix], NDArray[np.bool_]]
"""Takes joint vectors (n, dof); returns whether each is allowed (n,)."""

_SLICE_CELL_M = 0.005  # size of a cell of a slice
_VOLUME_CELL_M = 0.025  # size of a cell of a volume
_SAMPLES = 2**16  # number of postures that find most of the cells
# A search starts from the joints of a neighbouring cell; a few other starts get around limits.
_SLICE_RESTARTS = 8
_VOLUME_RESTARTS = 2  # fewer, because many border cells of a volume have several neighbours
_NEIGHBOURS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])


def workspace(
    chain: Chain,
    T_world_plane: Matrix | None = None,
    cell_m: float | None = None,
    samples: int = _SAMPLES,
    clear: Clear | None = None,
) -> Workspace:
    """Find the cells that the tip can reach inside the chain's limits.

    Joint vectors that fill the limits evenly give the first reachable cells. From these the solver
    continues outwards: it solves for the centre of every cell next to a reachable cell. A reachable
    island without a sample is missed.

    Args:
        chain: The arm.
        T_world_plane: The frame (4, 4) whose plane w = 0 is the slice; None for the whole volume.
        cell_m: Edge of the cells; None means 5 mm for a slice and 25 mm for a volume.
        samples: The number of joint vectors to try first.
        clear: Checks which joint vectors (n, dof) are allowed (n,), for example free of
            collisions; None allows all.

    Raises:
        BadValueError: The cell size is not positive, or there are too many cells.
    """
    q = quasi_random_joints(chain, samples)
    tip_m = tip_positions(chain, q)
    if T_world_plane is None:
        grid = grid_around(tip_m, _VOLUME_CELL_M if cell_m is None else cell_m)
        filling = _FloodFill(chain, grid, _VOLUME_RESTARTS, clear)
    else:
        grid = slice_around(tip_m, T_world_plane, _SLICE_CELL_M if cell_m is None else cell_m)
        filling = _FloodFill(chain, grid, _SLICE_RESTARTS, clear)
    filling.spread(filling.mark_reached(q, tip_m))
    return Workspace(grid, filling.reached, is_slice=T_world_plane is not None)


class _FloodFill:
    """Flood fill: the cells reached so far, and joints for each of them."""

    def __init__(self, chain: Chain, grid: VoxelGrid, restarts: int, clear: Clear | None) -> None:
        self._chain, self._grid, self._options = chain, grid, Options(restarts=restarts)
        self._clear = clear
        self.reached = np.zeros(grid.shape, dtype=np.bool_)
        self._joints = np.zeros((*grid.shape, chain.dof))

    def mark_reached(self, q: Matrix, tip_m: Matrix) -> Cells:
        """Mark the cells of tips (n, 3) at joints (n, dof); return the new cells (m, 3)."""
        cells, exist = self._grid.cells_of(tip_m)
        cells, q = cells[exist], q[exist]
        fresh = ~self.reached[tuple(cells.T)]
        if self._clear is not None and fresh.any():
            fresh[fresh] = self._clear(q[fresh])
        places = tuple(cells[fresh].T)
        self.reached[places] = True
        self._joints[places] = q[fresh]
        return np.unique(cells[fresh], axis=0)

    def spread(self, cells: Cells) -> None:
        """Solve for the cells around newly reached cells (n, 3) until no more cells are reached.

        A cell on the border is solved from each of its neighbours, because their joints differ.
        """
        while len(cells):
            around, starts = self._open_neighbours(cells)
            middles = self._grid.centres(around)
            q = solve_batch(self._chain, middles, starts, options=self._options).q
            cells = self.mark_reached(q, tip_positions(self._chain, q))

    def _open_neighbours(self, cells: Cells) -> tuple[Cells, Matrix]:
        """Return unreached neighbours (m, 3) of cells (n, 3), each with the joints of its cell."""
        around = (cells[:, None, :] + _NEIGHBOURS).reshape(-1, 3)
        origin = np.repeat(cells, len(_NEIGHBOURS), axis=0)
        exist = np.all((around >= 0) & (around < self._grid.shape), axis=1)
        around, origin = around[exist], origin[exist]
        is_open = ~self.reached[tuple(around.T)]
        return around[is_open], self._joints[tuple(origin[is_open].T)]

"""Which cells the tip can be in: forward samples first, then the solver, cell by cell outwards."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ikservo.ik.batch import solve_batch
from ikservo.ik.options import Options
from ikservo.ik.workspace.grid import Cells, Grid, grid_around, slice_around
from ikservo.ik.workspace.region import Workspace
from ikservo.ik.workspace.samples import joint_samples, tips
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix

__all__ = ["Clear", "workspace"]

Clear = Callable[[Matrix], NDArray[np.bool_]]
"""From joint vectors (n, dof) to whether each may be taken (n,)."""

_SLICE_CELL_M, _VOLUME_CELL_M = 0.005, 0.025
_SAMPLES = 2**16
# The start is a neighbouring cell's; a few others find the way round a limit. A volume has so
# many cells on its border, each with several neighbours, that fewer will do.
_SLICE_RESTARTS, _VOLUME_RESTARTS = 8, 2
_NEIGHBOURS = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]])


def workspace(
    chain: Chain,
    T_world_plane: Matrix | None = None,
    cell_m: float | None = None,
    samples: int = _SAMPLES,
    clear: Clear | None = None,
) -> Workspace:
    """Find the cells that the tip can be in, inside the chain's limits.

    Joint vectors that fill the limits evenly say where the tip can be at all; from those cells
    the solver goes outwards: it is asked for the middle of every cell beside a reachable one.
    An island of reach that holds no sample is missed.

    Args:
        chain: The arm; its limits are the limits.
        T_world_plane: The frame (4, 4) in whose plane w = 0 to cut; None for the whole volume.
        cell_m: Edge of the cells; 5 mm for a slice and 25 mm for a volume if None.
        samples: How many joint vectors to try first.
        clear: From joint vectors (n, dof) to whether each may be taken (n,), for example because
            it is free of collisions; all may if None.

    Raises:
        BadValueError: The cells have no size, or would be too many.
    """
    q = joint_samples(chain, samples)
    tip_m = tips(chain, q)
    if T_world_plane is None:
        grid = grid_around(tip_m, _VOLUME_CELL_M if cell_m is None else cell_m)
        filling = _Filling(chain, grid, _VOLUME_RESTARTS, clear)
    else:
        grid = slice_around(tip_m, T_world_plane, _SLICE_CELL_M if cell_m is None else cell_m)
        filling = _Filling(chain, grid, _SLICE_RESTARTS, clear)
    filling.spread(filling.note(q, tip_m))
    return Workspace(grid, filling.reached, is_slice=T_world_plane is not None)


class _Filling:
    """What is known of each cell so far: whether it is reached, and with which joints."""

    def __init__(self, chain: Chain, grid: Grid, restarts: int, clear: Clear | None) -> None:
        self._chain, self._grid, self._options = chain, grid, Options(restarts=restarts)
        self._clear = clear
        self.reached = np.zeros(grid.shape, dtype=np.bool_)
        self._joints = np.zeros((*grid.shape, chain.dof))

    def note(self, q: Matrix, tip_m: Matrix) -> Cells:
        """Mark the cells that tips (n, 3) at joints (n, dof) are in; return those new (m, 3)."""
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
        """Ask for the cells around newly reached ones (n, 3) until no more are reached.

        A cell on the border is asked for from each of its neighbours: their joints differ.
        """
        while len(cells):
            around, starts = self._beside(cells)
            middles = self._grid.centres(around)
            q = solve_batch(self._chain, middles, starts, options=self._options).q
            cells = self.note(q, tips(self._chain, q))

    def _beside(self, cells: Cells) -> tuple[Cells, Matrix]:
        """Return the open cells (m, 3) beside the given (n, 3), and the joints of those."""
        around = (cells[:, None, :] + _NEIGHBOURS).reshape(-1, 3)
        origin = np.repeat(cells, len(_NEIGHBOURS), axis=0)
        exist = np.all((around >= 0) & (around < self._grid.shape), axis=1)
        around, origin = around[exist], origin[exist]
        is_open = ~self.reached[tuple(around.T)]
        return around[is_open], self._joints[tuple(origin[is_open].T)]

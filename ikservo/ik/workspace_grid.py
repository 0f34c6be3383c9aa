"""Workspace as a voxel grid: slices and boundary polygons."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ikservo.errors import BadValueError
from ikservo.kinematics import Chain, JointType
from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector
from ikservo.kinematics.se3 import make_pose

Cells = NDArray[np.intp]
"""Integer indices (n, 3) of cells in a grid."""

# A slice or a volume with more cells than this comes from a wrong unit.
_MAX_CELLS = 5_000_000


@dataclass(frozen=True, slots=True, eq=False)
class VoxelGrid(FrozenArrays):
    """Cubes along the axes u, v, w of a frame.

    Attributes:
        T_world_grid: The frame (4, 4) of the cubes.
        first_m: The outer corner (3,) of cell (0, 0, 0) in that frame, metres.
        shape: The number of cells along u, v and w.
        cell_m: The edge of a cell.
    """

    T_world_grid: Matrix
    first_m: Vector
    shape: tuple[int, int, int]
    cell_m: float

    def to_grid(self, points_m: ArrayLike) -> Matrix:
        """Convert points (n, 3) from the base frame to the grid's own frame."""
        T = self.T_world_grid
        local: Matrix = (np.asarray(points_m, dtype=np.float64) - T[:3, 3]) @ T[:3, :3]
        return local

    def to_world(self, local_m: ArrayLike) -> Matrix:
        """Convert points (n, 3) from the grid's frame to the base frame."""
        T = self.T_world_grid
        world: Matrix = np.asarray(local_m, dtype=np.float64) @ T[:3, :3].T + T[:3, 3]
        return world

    def cells_of(self, points_m: ArrayLike) -> tuple[Cells, NDArray[np.bool_]]:
        """Compute the cells (n, 3) of points (n, 3), and whether each exists (n,)."""
        places = np.floor((self.to_grid(points_m) - self.first_m) / self.cell_m)
        exist: NDArray[np.bool_] = np.all((places >= 0) & (places < self.shape), axis=1)
        return np.where(exist[:, None], places, 0).astype(np.intp), exist

    def centres(self, cells: Cells) -> Matrix:
        """Compute the centres (n, 3) of cells in the base frame, metres."""
        return self.to_world(self.first_m + (cells + 0.5) * self.cell_m)


def grid_around(points_m: Matrix, cell_m: float) -> VoxelGrid:
    """Return cubes along the base frame's axes, with a margin around the points (n, 3)."""
    frame = np.eye(4)
    lower, upper = _bounding_box(points_m, frame)
    return _make_grid(frame, lower, upper, cell_m)


def slice_around(points_m: Matrix, T_world_plane: Matrix, cell_m: float) -> VoxelGrid:
    """Return one layer of cubes whose centres are in the plane w = 0 of a frame (4, 4)."""
    lower, upper = _bounding_box(points_m, T_world_plane)
    lower[2] = upper[2] = 0.0
    return _make_grid(T_world_plane, lower, upper, cell_m)


def _bounding_box(points_m: Matrix, frame: Matrix) -> tuple[Vector, Vector]:
    """Compute corners (3,) of a box around the points, with a margin for places samples miss."""
    local = VoxelGrid(frame, np.zeros(3), (1, 1, 1), 1.0).to_grid(points_m)
    lower, upper = local.min(axis=0), local.max(axis=0)
    spare = 0.05 * (upper - lower)
    return lower - spare, upper + spare


def _make_grid(frame: Matrix, lower: Vector, upper: Vector, cell_m: float) -> VoxelGrid:
    """Fill the box with an odd number of cells along each axis, so that one cell is centred.

    A flat region, such as the reach of an arm in one plane, is then in one layer of cells.
    """
    if not (math.isfinite(cell_m) and cell_m > 0):
        raise BadValueError("cell_m", cell_m, "a length above 0")
    half = np.ceil((upper - lower) / (2 * cell_m) - 1e-9)
    u, v, w = (2 * int(n) + 1 for n in half)
    if u * v * w > _MAX_CELLS:
        raise BadValueError("cell_m", f"{cell_m:g} m, too small: {u * v * w} cells", "larger cells")
    first = 0.5 * (lower + upper) - (half + 0.5) * cell_m
    return VoxelGrid(frame, first, (u, v, w), cell_m)


Corner = tuple[int, int]

# The four sides of a cell, traversed with the cell on the left: the neighbour on the other side,
# and the corners between which the side runs.
_SIDES = (
    ((0, -1), (0, 0), (1, 0)),
    ((1, 0), (1, 0), (1, 1)),
    ((0, 1), (1, 1), (0, 1)),
    ((-1, 0), (0, 1), (0, 0)),
)


def boundary_polygons(mask: NDArray[np.bool_]) -> tuple[Matrix, ...]:
    """Return closed polygons (k, 2) around the True cells of a mask (nu, nv), in units of cells.

    The True cells are on the left: islands run counterclockwise, holes clockwise. The first corner
    is not repeated, and no corner is on a straight line between its neighbours.
    """
    padded = np.pad(mask, 1)
    edges: dict[Corner, list[Corner]] = {}  # from each corner, the ends of outgoing border edges
    for (du, dv), start, end in _SIDES:
        open_side = mask & ~np.roll(padded, (-du, -dv), (0, 1))[1:-1, 1:-1]
        for u, v in np.argwhere(open_side).tolist():
            edges.setdefault((u + start[0], v + start[1]), []).append((u + end[0], v + end[1]))
    loops: list[Matrix] = []
    while edges:
        corners = np.array(_take_loop(edges), dtype=np.float64)
        ahead = np.roll(corners, -1, axis=0) - corners
        behind = corners - np.roll(corners, 1, axis=0)
        loops.append(corners[(ahead != behind).any(axis=1)])
    return tuple(loops)


def _take_loop(edges: dict[Corner, list[Corner]]) -> list[Corner]:
    """Remove one loop from the border and return it."""
    first = at = min(edges)
    loop: list[Corner] = []
    while not loop or at != first:
        loop.append(at)
        ends = edges[at]
        following = ends.pop()
        if not ends:
            del edges[at]
        at = following
    return loop


# A tool slightly off the middle of its arm must not rotate the plane of the arm.
_YAW_STEP_RAD = math.radians(15)


def side_plane(chain: Chain, home: ArrayLike, yaw_rad: float | None = None) -> Matrix:
    """Return the vertical plane of the arm, through its first axis.

    Args:
        chain: The arm.
        home: Joints (dof,) that point the arm in its usual working direction.
        yaw_rad: Direction of the plane, about z; None uses the direction of the arm at ``home``.

    Returns:
        T_world_plane (4, 4): u outward, v up, w across; u is 0 at the base's origin.
    """
    pivot, forward_rad = _first_axis(chain, home)
    return _vertical_plane(pivot, forward_rad if yaw_rad is None else yaw_rad)


def front_plane(chain: Chain, home: ArrayLike, yaw_rad: float | None = None) -> Matrix:
    """Return the vertical plane through the first axis, across the arm: u left, v up."""
    pivot, forward_rad = _first_axis(chain, home)
    return _vertical_plane(pivot, (forward_rad if yaw_rad is None else yaw_rad) + math.pi / 2)


def top_plane(chain: Chain, home: ArrayLike, height_m: float | None = None) -> Matrix:
    """Return the horizontal plane at a height; None uses the height of the tip at ``home``."""
    tip = chain.forward(home)[:3, 3]
    return make_pose((0.0, 0.0, float(tip[2]) if height_m is None else height_m))


def _vertical_plane(through: Vector, yaw_rad: float) -> Matrix:
    """Compute a vertical plane through a point; its origin is its point nearest the base origin."""
    u = np.array([math.cos(yaw_rad), math.sin(yaw_rad), 0.0])
    v = np.array([0.0, 0.0, 1.0])
    w = np.cross(u, v)
    return make_pose(float(through @ w) * w, np.column_stack([u, v, w]))


def _first_axis(chain: Chain, home: ArrayLike) -> tuple[Vector, float]:
    """Compute a point (3,) on the first axis and the direction from there to the tip."""
    T, J = chain.forward_and_jacobian(home)
    tip: Vector = T[:3, 3]
    pivot = np.zeros(3)
    if chain.kinds[0] is JointType.REVOLUTE:
        # J = axis x (tip - pivot), so axis x J leads from the tip back to the axis.
        pivot = tip + np.cross(J[3:, 0], J[:3, 0])
    yaw_rad = math.atan2(float(tip[1] - pivot[1]), float(tip[0] - pivot[0]))
    return pivot, _YAW_STEP_RAD * round(yaw_rad / _YAW_STEP_RAD)

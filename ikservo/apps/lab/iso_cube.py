"""Place the cube of ISO 9283 in the workspace: its test plane, poses, lines and circle."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ikservo.arm import OpenArm
from ikservo.errors import RefusedError
from ikservo.ik import Solver, Target
from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector
from ikservo.model.tool import tool_frame
from ikservo.planning.tool_orientation import KEEP_BEST_EFFORT, solve_with_orientation

EDGES_M = (0.25, 0.2, 0.16, 0.125, 0.1, 0.08, 0.063, 0.05, 0.04)
"""The edges that are tried, the largest first; the smallest cube of the standard has 250 mm."""

# The poses P2 to P5 are 10 % of a diagonal from its ends.
_OF_HALF_DIAGONAL = 0.8
# Diameter of the large circle, as a fraction of the edge.
_CIRCLE_OF_EDGE = 0.8
# Clearance of the arm's body from itself, the table and boxes, or 90 % of that in the pose home.
_CLEARANCE_M, _OF_HOME = 0.02, 0.9
# Least height of the tip above the surface on which the arm stands.
_HEIGHT_M = 0.05
_XS_M, _ZS_M = np.arange(0.1, 0.55, 0.025), np.arange(0.05, 0.4, 0.025)
# Steps between two points of the cube, and the largest turn of a joint in a step.
_STEPS, _MAX_STEP_RAD = 6, 0.5


@dataclass(frozen=True, slots=True, eq=False)
class IsoCube(FrozenArrays):
    """A cube with edges along the axes of the base frame, and its test plane.

    The test plane contains two diagonally opposite edges along y; for an arm that moves in a plane,
    it is that plane.

    Attributes:
        center_m: The centre (3,), which is P1.
        edge_m: The length of its edges.
        is_planar: Whether the arm moves in its x-y plane only.
    """

    center_m: Vector
    edge_m: float
    is_planar: bool = False

    @property
    def along_m(self) -> Matrix:
        """The two directions (2, 3) that span the test plane, half an edge long each."""
        half = 0.5 * self.edge_m
        first = (half, 0.0, 0.0 if self.is_planar else half)
        return np.array([first, (0.0, half, 0.0)])

    @property
    def poses_m(self) -> dict[str, Vector]:
        """Return P1 to P5: the centre, and four points on the diagonals of the test plane."""
        u, v = _OF_HALF_DIAGONAL * self.along_m
        c = self.center_m
        return {"P1": c, "P2": c + u + v, "P3": c - u + v, "P4": c - u - v, "P5": c + u - v}

    @property
    def normal(self) -> Vector:
        """The unit normal (3,) of the test plane."""
        across = np.cross(*self.along_m)
        return across / np.linalg.norm(across)

    @property
    def radius_m(self) -> float:
        """The radius of the circle about P1."""
        return 0.5 * _CIRCLE_OF_EDGE * self.edge_m

    @property
    def circle_start_m(self) -> Vector:
        """Start (3,) of the circle about P1."""
        v = self.along_m[1]
        return self.center_m + self.radius_m * v / np.linalg.norm(v)

    def lattice_m(self) -> Matrix:
        """Return points (k, 3) all over the cube, in the order in which they are visited."""
        steps = (-1.0, 0.0, 1.0)
        heights = (0.0,) if self.is_planar else steps
        cells = [(x, y, z) for z in heights for x in steps for y in steps]
        reach = 0.5 * self.edge_m * _OF_HALF_DIAGONAL
        return self.center_m + reach * np.array([(0.0, 0.0, 0.0), *cells])


def place_cube(arm: OpenArm) -> IsoCube:
    """Return the largest cube in the part of the workspace that contains the pose home.

    The tip reaches the whole cube in one IK branch. The body keeps 20 mm from itself, the table
    and boxes, or 90 % of its clearance in the pose home if that is less.

    Raises:
        RefusedError: Not even a cube with edges of 40 mm fits.
    """
    home_m = arm.chain.forward(arm.model.chain_pose("home"))[:3, 3]
    is_planar = bool(np.allclose(arm.chain.jacobian(arm.model.chain_pose("home"))[2], 0.0))
    solver = Solver(arm.chain, "position")
    # Centres (3,) in front of the arm, the nearest to the tip in the pose home first.
    heights = [home_m[2]] if is_planar else _ZS_M.tolist()
    centers = [np.array([x, 0.0, z]) for x in _XS_M.tolist() for z in heights]
    centers.sort(key=lambda center: math.dist(center, home_m))
    for edge_m in EDGES_M:
        for center_m in centers:
            cube = IsoCube(center_m, edge_m, is_planar)
            is_high = is_planar or center_m[2] - 0.5 * edge_m > _HEIGHT_M
            if is_high and _is_free(arm, solver, cube):
                return cube
    raise RefusedError(
        f"No cube of {1000 * EDGES_M[-1]:.0f} mm is free and within reach of this arm.",
        "Nothing moved. Clear the space in front of the arm, or check its limits.",
    )


def _is_free(arm: OpenArm, solver: Solver, cube: IsoCube) -> bool:
    """Check whether the arm reaches the whole cube in one IK branch and with enough clearance.

    The body must be clear if the tool keeps its orientation, as in motions. The orientation depends
    on the preceding motion, so the cube is visited twice.
    """
    home, tool = arm.model.chain_pose("home"), tool_frame(arm.model)
    q = home
    for points_m in pairwise([arm.chain.forward(q)[:3, 3], *cube.lattice_m()]):
        q = _follow(solver, *points_m, q)
        if q is None:
            return False
    everything = np.array([arm.model.pose("home").get(name, 0.0) for name in arm.joint_names])
    clearance_m = min(_CLEARANCE_M, _OF_HOME * arm.clearance_m(everything))
    q = home
    for point_m in np.concatenate([cube.lattice_m(), cube.lattice_m()]):
        q = solve_with_orientation(arm.chain, tool, Target(point_m), KEEP_BEST_EFFORT, q).q
        if arm.clearance_m(arm.joint_index.with_chain(everything, q)) < clearance_m:
            return False
    return True


def _follow(solver: Solver, begin_m: Vector, end_m: Vector, q: Vector) -> Vector | None:
    """Follow a line in steps; return the joints (dof,) at its end, None if that is not possible."""
    T = np.eye(4)
    for fraction in np.linspace(0.0, 1.0, _STEPS + 1)[1:].tolist():
        T[:3, 3] = begin_m + fraction * (end_m - begin_m)
        before = q
        q, is_reached = solver.track(T, before)
        if not is_reached or float(np.abs(q - before).max()) > _MAX_STEP_RAD:
            return None
    return q

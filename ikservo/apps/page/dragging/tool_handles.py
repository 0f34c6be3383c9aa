"""Handles of the tool in the 3D scene: possible motions of the tool, and drags of the handles.

::

    handles = ToolHandles(chain, approach_axis)
    handles.description                   # sent once: which arrows and how many rings there are
    handles.axes(q)                       # R_base_handles (3, 3): the axes of the rings first

    drag = ToolDrag(chain)
    drag.press(q)
    command = drag.move(shift_m, turn_rad)     # ToolPoseTarget, from where the tool was pressed
"""

from __future__ import annotations

import numpy as np

from ikservo.apps.page.dragging.drag_commands import ToolPoseTarget
from ikservo.apps.page.dragging.target_marker import TargetMarker
from ikservo.ik import Options, Solver
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import exp_so3, log_so3, make_pose
from ikservo.planning.tool_orientation import ORIENTATION_TOLERANCE_RAD, ArmPlane

_SAMPLES = 16  # number of postures; the one with most freedom decides
_RANK = 1e-3  # rank tolerance, relative to the largest singular value
_ALONG = 0.5  # fraction of the tool axis below which the tool cannot roll
_PASSES = 3  # iterations, because the arm's plane turns with the solution


class ToolHandles:
    """The degrees of freedom in which the arm can move its tool.

    Args:
        chain: The arm.
        approach_axis: The tool axis (3,), in the coordinates of the tip.
    """

    def __init__(self, chain: Chain, approach_axis: Vector) -> None:
        self._chain, self._approach = chain, approach_axis
        lower, upper = np.maximum(chain.lower_rad, -np.pi), np.minimum(chain.upper_rad, np.pi)
        samples = np.random.default_rng(0).uniform(lower, upper, (_SAMPLES, chain.dof))
        jacobians = [chain.jacobian(q) for q in samples]
        sizes = np.max([np.linalg.norm(J[:3], axis=1) for J in jacobians], axis=0)
        self._moves: list[bool] = (sizes > _RANK * sizes.max()).tolist()
        self._turns = max(int((np.linalg.svd(_turning(J))[1] > _RANK).sum()) for J in jacobians)

    @property
    def description(self) -> dict[str, object]:
        """The base axes along which the tool moves, and the number of axes about which it turns."""
        return {"moves": self._moves, "turns": self._turns}

    def axes(self, q: Vector) -> Matrix:
        """Compute R_base_handles (3, 3) at joints (dof,); the tool turns about its first columns.

        The columns are the tool axis, if the tool can roll, and axes across it about which the tool
        can turn while its tip stays (null space of the tip's velocity).
        """
        T, J = self._chain.forward_and_jacobian(q)
        approach = T[:3, :3] @ self._approach
        if self._turns in (0, 3):
            return _frame_along(approach, T[:3, :3])
        span = np.linalg.svd(_turning(J))[0][:, : self._turns]
        along = span @ (span.T @ approach)
        length = float(np.linalg.norm(along))
        first = along / length if length > _ALONG else span[:, 0]
        if self._turns == 1:
            return _frame_along(first, T[:3, :3])
        second = np.cross(np.cross(span[:, 0], span[:, 1]), first)
        second = second / np.linalg.norm(second)
        return np.column_stack([first, second, np.cross(first, second)])


def _turning(J: Matrix) -> Matrix:
    """Compute angular velocities (3, 3) that do not move the tip, from a Jacobian (6, dof)."""
    _, sizes, rows = np.linalg.svd(J[:3])
    still = rows[int((sizes > _RANK * sizes[0]).sum()) :].T
    padded = np.zeros((3, max(3, still.shape[1])))
    padded[:, : still.shape[1]] = J[3:] @ still
    return padded


def _frame_along(first: Vector, R: Matrix) -> Matrix:
    """Compute a frame (3, 3) with a given first axis, otherwise near an orientation (3, 3)."""
    across = R[:, int(np.argmin(np.abs(R.T @ first)))]
    second = across - first * float(across @ first)
    second = second / np.linalg.norm(second)
    return np.column_stack([first, second, np.cross(first, second)])


class ToolDrag:
    """A drag of the handles, relative to the pose of the tool when they were pressed."""

    def __init__(self, chain: Chain) -> None:
        self._chain, self._plane = chain, ArmPlane(chain)
        self._pressed: tuple[Matrix, Matrix] | None = None

    @property
    def is_busy(self) -> bool:
        """Whether the handles are held."""
        return self._pressed is not None

    def press(self, q: Vector) -> None:
        """Grab the tool at joints (dof,)."""
        T = self._chain.forward(q)
        self._pressed = T, self._plane.rotation(q).T @ T[:3, :3]

    def move(self, shift_m: Vector, turn_rad: Vector) -> ToolPoseTarget | None:
        """Compute the target for a shift and a rotation vector (3,) since the press, base frame.

        If the tool is only shifted, an arm with four or five joints keeps its orientation in the
        arm's own plane, which turns with the shift. None if the handles are not held.
        """
        if self._pressed is None:
            return None
        T, in_plane = self._pressed
        position_m = T[:3, 3] + shift_m
        if not turn_rad.any():
            return ToolPoseTarget(position_m, in_plane, in_plane=True)
        return ToolPoseTarget(position_m, exp_so3(turn_rad) @ T[:3, :3])

    def release(self) -> None:
        """Release the handles; the last target stays."""
        self._pressed = None


class ToolPoseSolver:
    """Tracker of tool poses on the present IK branch: the position first, then the orientation."""

    def __init__(self, chain: Chain) -> None:
        self._chain, self._plane = chain, ArmPlane(chain)
        self._solver = Solver(chain, "pose", options=Options(position_first=True))

    def track(self, target: ToolPoseTarget, start: Vector) -> tuple[Vector, TargetMarker]:
        """Compute the joints (dof,) for a tool pose from joints (dof,), and the target marker."""
        q, binding = start, ()
        wanted = self._wanted(target, q)
        for _ in range(_PASSES if target.in_plane and self._plane.rotates else 1):
            wanted = self._wanted(target, q)
            q = self._solver.track(make_pose(target.position_m, wanted), q)[0].copy()
            binding = self._solver.result.binding
        T, solved = self._chain.forward(q), self._solver.result
        error_rad = float(np.linalg.norm(log_so3(wanted @ T[:3, :3].T)))
        # An orientation that is kept only if possible counts as reached.
        turned = target.in_plane or error_rad <= ORIENTATION_TOLERANCE_RAD
        marker = TargetMarker(
            target.position_m,
            T[:3, 3],
            solved.position_error_m <= Options().tolerance.position_m and turned,
            binding,
            turn_error_rad=0.0 if turned else error_rad,
        )
        return q, marker

    def _wanted(self, target: ToolPoseTarget, q: Vector) -> Matrix:
        if not target.in_plane:
            return target.orientation
        wanted: Matrix = self._plane.rotation(q) @ target.orientation
        return wanted

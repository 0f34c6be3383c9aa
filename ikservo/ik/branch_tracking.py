"""``Solver``: warm-started tracking of moving targets that remembers its branch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING, NoReturn, cast

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError, InputError
from ikservo.ik.bounded import unpack_result
from ikservo.ik.prepare import (
    HOMOGENEOUS_ROW,
    PackedProblem,
    SolverBuffers,
    TargetKind,
    TargetKindName,
    check_homogeneous_row,
    check_options,
    pack_problem,
    pack_settings,
    target_kind,
)
from ikservo.ik.problem import (
    ArmLike,
    Options,
    Tolerance,
    chain_and_start,
    check_position,
    normalise,
)
from ikservo.ik.result import Result
from ikservo.kernels.compiled import bind
from ikservo.kernels.layout import (
    IDLE_OUTSIDE,
    IDLE_WIDTH,
    IS_REACHED,
    ITERATIONS,
    MAX_ANGLE_RAD,
    NOT_HOMOGENEOUS,
)
from ikservo.kinematics import finite_array, finite_vector
from ikservo.kinematics.arrays import Vector

if TYPE_CHECKING:
    from ikservo.ik.droop import Droop

PoseKernel = Callable[[ArrayLike, ArrayLike], int]
"""Takes pose (4, 4) and start (dof,); see ``kernels.single``."""

_FLOAT64 = np.dtype(np.float64)
# A start this close to the last result continues its path.
_SAME_RAD = 0.01
# With at least this bend it is clear to which side the arm bends. Redundant joints are also moved
# away from their limits by up to this angle, because they would block at a limit later.
_MIN_BEND_RAD = 0.3


class BranchMemory:
    """Memory of the posture that a path had before its target went out of reach.

    When its target is out of reach, an arm stretches until it is straight, and could then bend to
    either side. When a target is in reach again, the search therefore starts from positions
    slightly bent towards the last ones that reached a target.

    Args:
        dof: Number of joints.
    """

    def __init__(self, dof: int) -> None:
        self._last, self._bent = np.full(dof, np.nan), np.full(dof, np.nan)
        self._out = False

    def is_beyond_reach(self, q0: ArrayLike) -> bool:
        """Check whether ``q0`` (dof,) continues a path whose last target was out of reach."""
        return self._out and self._is_same_path(q0)

    def start_joints(self) -> Vector:
        """Compute the start (dof,) for a target that is within reach again."""
        back: Vector = np.clip(self._bent - self._last, -_MIN_BEND_RAD, _MIN_BEND_RAD)
        return self._last + back

    def update(self, q0: ArrayLike, q: Vector, *, reached: bool) -> None:
        """Update with the solution ``q`` (dof,) found from ``q0`` (dof,)."""
        if reached:
            self._bent[:] = q
        elif not self._is_same_path(q0):
            self._bent[:] = q0
        self._last[:], self._out = q, not reached

    def _is_same_path(self, q0: ArrayLike) -> bool:
        return bool(np.abs(np.asarray(q0) - self._last).max() <= _SAME_RAD)


class Solver:
    """A solver prepared once for calls in a loop; use one object per thread.

    A call is ``solve(…, nearest=False)``: it starts at ``q0`` and restarts elsewhere if that fails.
    Joints that do not move the point stay at ``q0``. ``track`` follows a path: it searches from
    ``q0`` only, never jumps to another branch, and moves as near to the target as it can if a limit
    is in the way. If a path that continues from the last result has stretched the arm straight, the
    arm bends back to the side from which it came.

    Args:
        chain: The arm, or its model, its name, or the path of its file.
        kind: The part of the pose that counts: the position, the position and the direction of the
            tool axis, or the whole pose.
        tool_axis: The axis (3,) in the frame's coordinates for "direction".
        frame: The link to move to the target; the tip if None.
        offset_m: The point (3,) on that link, metres; the link's origin if None.
        tolerance: The maximum errors of a reached target; not used if ``options`` are given.
        options: Tolerance, search limits and priorities.

    Raises:
        BadValueError: An axis or offset is invalid, or the arm is missing.
        UnknownNameError: There is no such arm, kind or frame.
    """

    def __init__(
        self,
        chain: ArmLike,
        kind: TargetKindName = "position",
        *,
        tool_axis: ArrayLike = (0.0, 0.0, 1.0),
        tolerance: Tolerance | None = None,
        frame: str | None = None,
        offset_m: ArrayLike | None = None,
        options: Options | None = None,
    ) -> None:
        chain, _ = chain_and_start(chain)
        if options is None:
            options = Options(Tolerance() if tolerance is None else tolerance)
        check_options(options)
        self.chain, self.kind = chain, kind
        self._kind = target_kind(kind)
        self._axis = normalise(tool_axis, "tool_axis")
        offset = None if offset_m is None else check_position(offset_m, "offset_m")
        axis = self._axis if self._kind is TargetKind.DIRECTION else None
        ready = pack_problem(chain.rigid, frame, offset, axis, options.restarts)
        self._droop: Droop | None = None
        if chain.link_joints is not None:
            from ikservo.ik.droop import Droop  # noqa: PLC0415  # few arms need it

            self._droop = Droop(chain, frame, offset_m)
        self._idle = ready.idle[self._kind]
        self._worker = SolverBuffers(chain.dof, options.restarts)
        self._worker.answer[:] = np.nan
        self._joints = self._worker.answer[0, : chain.dof]
        self._solve = self._bound_kernel(ready, options)
        self._track = self._bound_kernel(ready, replace(options, track=True))
        self._shape = (chain.dof,)
        self._side = BranchMemory(chain.dof)

    def _bound_kernel(self, ready: PackedProblem, options: Options) -> PoseKernel:
        """Return the kernel with all arguments bound except pose and start."""
        from ikservo.kernels import single  # noqa: PLC0415  # loads with the first solver

        worker, idle = self._worker, np.zeros((len(self._idle), IDLE_WIDTH))
        for row, joint in zip(idle, self._idle, strict=True):
            row[:] = joint.column, joint.lower, joint.upper
        settings = pack_settings(self._kind, self.chain.dof, options)
        solve = bind(
            single.NAME, ready.arm, worker.question, settings, worker.start, ready.seeds,
            worker.work, worker.scores, worker.trace, worker.answer, self._axis, idle,
        )  # fmt: skip
        return cast("PoseKernel", solve)

    def __repr__(self) -> str:
        """Return the kind of target and the chain as text."""
        return f"Solver(kind={self.kind!r}, {self.chain.dof} joints to {self.chain.tip!r})"

    def __call__(
        self, T_world_tool: ArrayLike, q0: ArrayLike, out: Vector | None = None
    ) -> tuple[Vector, bool]:
        """Return joints (dof,) for a pose (4, 4), near ``q0`` (dof,), and whether they reach it.

        The joints are written to ``out`` (dof,) if given; otherwise to a new array.

        Raises:
            BadValueError: A shape is wrong, or a number that matters is not finite, too large or
                not part of a rotation.
        """
        return self._solve_drooping(self._solve, T_world_tool, q0, out)

    def track(
        self, T_world_tool: ArrayLike, q0: ArrayLike, out: Vector | None = None
    ) -> tuple[Vector, bool]:
        """Compute the joint positions on the branch of ``q0``, and whether they reach the target.

        Arguments and errors are those of a call; ``result`` names any limit that blocks.
        """
        solve = self._solve_drooping
        q, reached = solve(self._track, T_world_tool, q0, out)
        if reached and self._side.is_beyond_reach(q0):
            q, reached = solve(self._track, T_world_tool, self._side.start_joints(), out)
            if not reached:
                q, reached = solve(self._track, T_world_tool, q0, out)
        self._side.update(q0, q, reached=reached)
        return q, reached

    @property
    def result(self) -> Result:
        """The whole result of the last call: errors and active limits.

        Raises:
            InputError: There has been no call yet.
        """
        if not self._worker.answer[0, 2 * self.chain.dof + ITERATIONS] >= 0.0:
            raise InputError("The solver has no result yet.", "Solve a target first.")
        found = unpack_result(self.chain, self._worker.answer[0], "bounded")
        droop = self._droop
        return found if droop is None else replace(found, nearest_m=droop.lowered(found.nearest_m))

    def _solve_drooping(
        self, solve: PoseKernel, T: ArrayLike, q0: ArrayLike, out: Vector | None
    ) -> tuple[Vector, bool]:
        """Run the kernel for a sagging arm, with targets raised by the sag."""
        if self._droop is None:
            return self._run_kernel(solve, T, q0, out)
        pose, q = finite_array(T, (4, 4), "T_world_tool"), finite_vector(q0, self.chain.dof, "q0")
        self._droop.follow(q)
        reached = False
        for _ in range(self._droop.max_steps):
            q, reached = self._run_kernel(solve, self._droop.raised_pose(pose), q, out)
            if not self._droop.follow(q):
                break
        else:
            reached = reached and self._droop.is_steady
        return q, reached

    def _run_kernel(
        self, solve: PoseKernel, T: ArrayLike, q0: ArrayLike, out: Vector | None
    ) -> tuple[Vector, bool]:
        try:
            status = solve(T, q0)
        except (TypeError, ValueError, BufferError):
            status = NOT_HOMOGENEOUS  # the arrays do not have the types that the kernel needs
        if status == IS_REACHED and out is None:  # most calls end here
            return self._joints.copy(), True
        if status < 0:
            status = self._run_with_copies(solve, T, q0)
        if status >= IDLE_OUTSIDE:
            for joint in self._idle:
                start = self._worker.start.item(joint.column)
                self._joints[joint.column] = joint.resting_position(start)
        reached = bool(status & IS_REACHED)
        if out is None:
            return self._joints.copy(), reached
        if type(out) is not np.ndarray or out.shape != self._shape or out.dtype != _FLOAT64:
            raise BadValueError("out", f"{out!r}", f"an array of floats of shape {self._shape}")
        out[:] = self._joints
        return out, reached

    def _run_with_copies(self, solve: PoseKernel, T: ArrayLike, q0: ArrayLike) -> int:
        """Solve with copies of arguments that are not plain arrays; raise if they are not valid."""
        try:
            pose, start = np.array(T, dtype=np.float64, order="C"), np.array(q0, dtype=np.float64)
        except (TypeError, ValueError, OverflowError):
            self._raise_invalid(T, q0)
        if pose.shape != (4, 4) or start.shape != self._shape:
            self._raise_invalid(T, q0)
        check_homogeneous_row(pose, "T_world_tool")
        pose[3] = HOMOGENEOUS_ROW
        status = solve(pose, start)
        if status < 0:
            self._raise_invalid(T, q0)
        return status

    def _raise_invalid(self, T: ArrayLike, q0: ArrayLike) -> NoReturn:
        """Raise the error for a target that the kernel did not accept."""
        start = finite_vector(q0, self.chain.dof, "q0")
        if float(np.abs(start).max()) > MAX_ANGLE_RAD:
            raise BadValueError("q0", start.tolist(), "radians or metres, at most 1e6")
        check_position(finite_array(T, (4, 4), "T_world_tool")[:3, 3], "The target position")
        raise BadValueError("The rotation of T_world_tool", "invalid", "R Rᵀ = 1 and det R = 1")

"""Inverse kinematics for a drag: the goal follows the pointer on its branch, within limits.

::

    solver = DragSolver(chain)
    solver.method = "ccd"                             # for drags as well as clicks
    solver.posture = Posture(q_pref, weights)         # preferred if the target leaves freedom
    solution = solver.solve_command(command, q_goal)  # q_goal: the goal so far, or measured
    q_goal = solution.q                               # repeat the command until settled
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ikservo.apps.page.dragging.drag_commands import (
    DragCommand,
    DragTarget,
    HoldCommand,
    JointTarget,
    ToolPoseTarget,
)
from ikservo.apps.page.dragging.target_marker import TargetMarker
from ikservo.apps.page.dragging.tool_handles import ToolPoseSolver
from ikservo.arm import ToolOrientation
from ikservo.errors import UnknownNameError
from ikservo.ik import Options, Posture, Result, Solver, Target, solve
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector
from ikservo.kinematics.se3 import make_pose
from ikservo.model import Model

MAX_STEP_RAD = math.radians(8.0)
"""The largest joint step per solve of a drag: larger steps are scaled down as a whole."""

_RESTARTS = 12
# Iterations per frame; the next frames continue.
_ITERATIONS, _EXTRA_ITERATIONS = 2, 20
_CLICK_ITERATIONS = 120
_AT_REST_RAD = 1e-5
AUTO = "auto"
"""The default: track the current IK branch with the production solver."""


@dataclass(frozen=True, slots=True, eq=False)
class DragSolution:
    """The solution of a drag command.

    Attributes:
        q: Joints (dof,), inside the limits.
        marker: The target, and the point that the goal reaches; None without a target.
        settled: Whether solving the same command again brings no further progress.
        text: Progress of a chosen method; empty for ``auto``.
    """

    q: Vector
    marker: TargetMarker | None
    settled: bool = True
    text: str = ""


class DragSolver:
    """Solver of drag commands; the joints beyond a grabbed link stay as they are.

    Attributes:
        method: ``auto``, or one of ``ikservo.ik.METHODS``.
        posture: Preferred posture if the target leaves freedom (null-space motion), for
            ``auto`` and ``pseudo_inverse``; the other methods have no null space.
    """

    def __init__(self, chain: Chain) -> None:
        self._chain = chain
        self.method = AUTO
        self.posture: Posture | None = None
        self._tool_solver = ToolPoseSolver(chain)
        self._cached: tuple[str | None, bytes, Solver] | None = None

    def solve_command(self, command: DragCommand, q: Vector) -> DragSolution:
        """Find the goal for a command, from joints (dof,) that may be outside the limits.

        Raises:
            UnknownNameError: The command names no joint or link of the arm.
        """
        start = self._chain.clip(q)
        if isinstance(command, HoldCommand):
            return DragSolution(start, None)
        if isinstance(command, JointTarget):
            if command.joint not in self._chain.names:
                raise UnknownNameError("joint", command.joint, self._chain.names)
            q = start.copy()
            q[self._chain.names.index(command.joint)] = command.position
            return DragSolution(self._chain.clip(q), None)
        if isinstance(command, ToolPoseTarget):
            found, marker = self._tool_solver.track(command, start)
            q, is_limited = self._limit_step(start, found)
            settled = not is_limited and _max_joint_distance(found, start) < _AT_REST_RAD
            return DragSolution(q, marker, settled)
        if self.method != AUTO and not command.is_click:
            return self._iterate_method(command, start)
        tracked = self._track_target(command, start)
        leaning = self._lean_to_posture(command, tracked)
        if command.is_click:
            return DragSolution(leaning.q, _make_marker(command.target, leaning))
        q, is_limited = self._limit_step(start, leaning.q)
        settled = not is_limited and _max_joint_distance(leaning.q, tracked.q) < _AT_REST_RAD
        return DragSolution(q, _make_marker(command.target, tracked), settled)

    def _track_target(self, command: DragTarget, start: Vector) -> Result:
        """Track the current IK branch; a click may switch to another branch."""
        solver, T_target = self._solver_for(command.target), make_pose(command.target.position)
        solver.track(T_target, start)
        tracked = solver.result
        if tracked.reached or not command.is_click:
            return tracked
        solver(T_target, start)  # search from several starts
        found = solver.result
        return found if found.position_error_m < tracked.position_error_m else tracked

    def _lean_to_posture(self, command: DragTarget, found: Result) -> Result:
        """Move towards the preferred posture without leaving the target."""
        posture = self._posture_for(command.target)
        if posture is None or not found.reached:
            return found
        count = _CLICK_ITERATIONS if command.is_click else _ITERATIONS
        q_leaned = solve(
            self._chain, command.target, found.q, "pseudo_inverse",
            posture=posture, max_iterations=count, trace=True,
        ).trace[-1]  # fmt: skip
        solver = self._solver_for(command.target)
        # Correct the drift of the null-space steps.
        solver.track(make_pose(command.target.position), q_leaned)
        leaning = solver.result
        return leaning if leaning.reached else found

    def _iterate_method(self, command: DragTarget, start: Vector) -> DragSolution:
        """Run the chosen method from the current joint positions; the next frame continues."""
        posture = self._posture_for(command.target)
        for count in (_ITERATIONS, _EXTRA_ITERATIONS):  # the error may grow before it decreases
            found = solve(
                self._chain, command.target, start, self.method,
                restarts=1, max_iterations=count, posture=posture,
            )  # fmt: skip
            if _max_joint_distance(found.q, start) > _AT_REST_RAD:
                break
        q, is_limited = self._limit_step(start, found.q)
        settled = not is_limited and (
            found.reached or _max_joint_distance(found.q, start) <= _AT_REST_RAD
        )
        if posture is not None and self.method == "pseudo_inverse":
            settled = _max_joint_distance(found.q, start) <= _AT_REST_RAD
        text = f"{found.method}: {found.position_error_m * 1000:.1f} mm left"
        return DragSolution(q, _make_marker(command.target, found), settled, text)

    def _posture_for(self, target: Target) -> Posture | None:
        """Return the posture for the joints that move the target's frame; other joints stay."""
        if self.posture is None or target.frame is None:
            return self.posture
        moving = {step.column for step in self._chain.joints_to(target.frame) if step.scale}
        weights = np.array(self.posture.weights, dtype=np.float64)
        weights[[i for i in range(self._chain.dof) if i not in moving]] = 0.0
        return Posture(self.posture.q, weights)

    def _limit_step(self, start: Vector, q: Vector) -> tuple[Vector, bool]:
        """Limit the step to 8° per joint; return the positions, and whether it was scaled."""
        max_distance = _max_joint_distance(q, start)
        if max_distance <= MAX_STEP_RAD:
            return q, False
        return self._chain.clip(start + (q - start) * (MAX_STEP_RAD / max_distance)), True

    def _solver_for(self, target: Target) -> Solver:
        """Return the solver for the dragged point; it is cached during a drag."""
        offset = None if target.offset_m is None else np.asarray(target.offset_m, np.float64)
        offset_key = b"" if offset is None else offset.tobytes()
        if self._cached is None or self._cached[:2] != (target.frame, offset_key):
            options = Options(restarts=_RESTARTS)
            solver = Solver(self._chain, frame=target.frame, offset_m=offset, options=options)
            self._cached = (target.frame, offset_key, solver)
        return self._cached[2]


def _max_joint_distance(a: Vector, b: Vector) -> float:
    return float(np.abs(a - b).max(initial=0.0))


def _make_marker(target: Target, found: Result) -> TargetMarker:
    return TargetMarker(
        target.position,
        found.nearest_m,
        found.reached,
        found.binding,
        target.frame,
        stance=ToolOrientation() if target.frame is None else None,
    )


NONE, CURRENT_POSTURE = "none", "here"
"""Choices other than a named pose: no preferred posture, or the arm's posture at that moment."""

_LEANING_METHODS = ("auto", "pseudo_inverse")


@dataclass(frozen=True, slots=True)
class PosturePreference:
    """A preferred pose with a weight for each joint.

    Attributes:
        pose: ``none``, ``here`` or the name of a pose of the arm.
        weights: Weights of the joints; 1 if missing, and 0 ignores a joint.
    """

    pose: str = NONE
    weights: Mapping[str, float] = field(default_factory=dict[str, float])

    def make_posture(self, model: Model, chain: Chain, here: Vector) -> Posture | None:
        """Make the posture from the chain's current joints (dof,); None for ``none``.

        Raises:
            UnknownNameError: There is no such pose or joint.
        """
        for name in self.weights:
            if name not in chain.names:
                raise UnknownNameError("joint", name, chain.names)
        if self.pose == NONE:
            return None
        q = here.copy() if self.pose == CURRENT_POSTURE else model.chain_pose(self.pose)
        return Posture(q, np.array([self.weights.get(name, 1.0) for name in chain.names]))

    def page_fields(self, solver: str) -> dict[str, object]:
        """Return the preference as fields for the page, with a note if the solver ignores it."""
        idle = self.pose != NONE and solver not in _LEANING_METHODS
        note = (
            f"{solver} does not use the null space, so it cannot prefer a posture." if idle else ""
        )
        return {"pose": self.pose, "weights": dict(self.weights), "note": note}

"""Inverse kinematics for a drag: the goal follows the pointer on its branch, within limits.

::

    puppet = Puppet(chain)
    puppet.method = "ccd"                         # drags, too, are answered by a chosen method
    puppet.posture = Posture(q_pref, weights)     # to lean towards where the target leaves freedom
    answer = puppet.answer(wish, q_goal)          # q_goal: the goal so far, or where the arm is
    q_goal = answer.q                             # once more with the same wish until settled
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ikservo.errors import UnknownNameError
from ikservo.ik import Options, Posture, Result, Solver, Target, solve
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import make_pose
from ikservo.view.draw_items import TargetMarker
from ikservo.view.messages import DragCommand, DragTarget, HoldCommand, JointTarget

__all__ = ["AUTO", "MAX_STEP_RAD", "DragSolution", "DragSolver"]

MAX_STEP_RAD = math.radians(8.0)
"""The furthest any joint goes in one answer to a drag: the whole step is scaled (lecture L7)."""

_RESTARTS = 12
# A picture's worth of iterations; the pictures that follow go on.
_ITERATIONS, _EXTRA_ITERATIONS = 2, 20
_CLICK_ITERATIONS = 120
_AT_REST_RAD = 1e-5
AUTO = "auto"
"""Goes on along the branch the arm is on, by the production solver."""


@dataclass(frozen=True, slots=True, eq=False)
class DragSolution:
    """The goal that a wish leads to.

    Attributes:
        q: Joints (dof,), inside the limits.
        aim: The target and how near the goal comes to it; None where there is none.
        settled: Whether the same wish would lead no further.
        words: What a chosen method has done; empty for ``auto``.
    """

    q: Vector
    aim: TargetMarker | None
    settled: bool = True
    words: str = ""


class DragSolver:
    """Answers wishes; the joints beyond a grabbed link stay as they are.

    Args:
        chain: The arm, inside its own limits.

    Attributes:
        method: ``auto``, or one of ``ikservo.ik.METHODS`` for what is pulled.
        posture: What to lean towards where the target leaves freedom (lecture L10), by ``auto`` and
            ``pseudo_inverse``; the other methods have no null space.
    """

    def __init__(self, chain: Chain) -> None:
        self._chain = chain
        self.method = AUTO
        self.posture: Posture | None = None
        self._kept: tuple[str | None, bytes, Solver] | None = None

    def solve_command(self, wish: DragCommand, q: Vector) -> DragSolution:
        """Return the goal for a wish, from joints (dof,) that may lie outside the limits.

        Raises:
            UnknownNameError: The wish names no joint or link of the arm.
        """
        start = self._chain.clip(q)
        if isinstance(wish, HoldCommand):
            return DragSolution(start, None)
        if isinstance(wish, JointTarget):
            return DragSolution(self._solve_turn(wish, start), None)
        return self._solve_pull(wish, start)

    def _solve_turn(self, wish: JointTarget, start: Vector) -> Vector:
        if wish.joint not in self._chain.names:
            raise UnknownNameError("joint", wish.joint, self._chain.names)
        q = start.copy()
        q[self._chain.names.index(wish.joint)] = wish.position
        return self._chain.clip(q)

    def _solve_pull(self, wish: DragTarget, start: Vector) -> DragSolution:
        """Return the joints for a point that is pulled, at most one picture's step further."""
        if self.method != AUTO and not wish.is_click:
            return self._iterate_method(wish, start)
        found = self._track_target(wish, start)
        leaning = self._lean_to_posture(wish, found)
        if wish.is_click:
            return DragSolution(leaning.q, _make_marker(wish.target, leaning))
        q, shortened = self._limit_step(start, leaning.q)
        settled = not shortened and _max_joint_distance(leaning.q, found.q) < _AT_REST_RAD
        return DragSolution(q, _make_marker(wish.target, found), settled)

    def _track_target(self, wish: DragTarget, start: Vector) -> Result:
        """Go on along the branch the arm is on; a click may look for another way to fold."""
        solver, there = self._solver_for(wish.target), make_pose(wish.target.position)
        solver.track(there, start)
        found = solver.result
        return (
            _prefer_nearer(found, solver, there, start)
            if wish.is_click and not found.reached
            else found
        )

    def _lean_to_posture(self, wish: DragTarget, found: Result) -> Result:
        """Go some way towards the posture without leaving the target."""
        posture = self._posture_for(wish.target)
        if posture is None or not found.reached:
            return found
        count = _CLICK_ITERATIONS if wish.is_click else _ITERATIONS
        walked = solve(
            self._chain, wish.target, found.q, "pseudo_inverse",
            posture=posture, max_iterations=count, trace=True,
        ).trace[-1]  # fmt: skip
        solver = self._solver_for(wish.target)
        solver.track(
            make_pose(wish.target.position), walked
        )  # a few steps leave the target a little
        leaning = solver.result
        return leaning if leaning.reached else found

    def _iterate_method(self, wish: DragTarget, start: Vector) -> DragSolution:
        """Let the chosen method go on from where the arm is; the next picture goes on again."""
        posture = self._posture_for(wish.target)
        for count in (
            _ITERATIONS,
            _EXTRA_ITERATIONS,
        ):  # an error may grow at first and then come down
            found = solve(
                self._chain, wish.target, start, self.method,
                restarts=1, max_iterations=count, posture=posture,
            )  # fmt: skip
            if _max_joint_distance(found.q, start) > _AT_REST_RAD:
                break
        q, shortened = self._limit_step(start, found.q)
        settled = not shortened and (
            found.reached or _max_joint_distance(found.q, start) <= _AT_REST_RAD
        )
        if posture is not None and self.method == "pseudo_inverse":
            settled = _max_joint_distance(found.q, start) <= _AT_REST_RAD
        words = f"{found.method}: {found.position_error_m * 1000:.1f} mm left"
        return DragSolution(q, _make_marker(wish.target, found), settled, words)

    def _posture_for(self, target: Target) -> Posture | None:
        """Return the posture for the joints that move the target's frame; the others stay."""
        if self.posture is None or target.frame is None:
            return self.posture
        moving = {step.column for step in self._chain.joints_to(target.frame) if step.scale}
        weights = np.array(self.posture.weights, dtype=np.float64)
        weights[[i for i in range(self._chain.dof) if i not in moving]] = 0.0
        return Posture(self.posture.q, weights)

    def _limit_step(self, start: Vector, q: Vector) -> tuple[Vector, bool]:
        """Return joints at most 8° from the start on the way to q, and whether that is short."""
        longest = _max_joint_distance(q, start)
        if longest <= MAX_STEP_RAD:
            return q, False
        return self._chain.clip(start + (q - start) * (MAX_STEP_RAD / longest)), True

    def _solver_for(self, target: Target) -> Solver:
        """Return the solver for the point that is pulled; that of one drag is kept."""
        offset = None if target.offset_m is None else np.asarray(target.offset_m, np.float64)
        name = b"" if offset is None else offset.tobytes()
        if self._kept is None or self._kept[:2] != (target.frame, name):
            options = Options(restarts=_RESTARTS)
            solver = Solver(self._chain, frame=target.frame, offset_m=offset, options=options)
            self._kept = (target.frame, name, solver)
        return self._kept[2]


def _prefer_nearer(tracked: Result, solver: Solver, there: Matrix, start: Vector) -> Result:
    """Return what a search from many starts finds, where that comes nearer."""
    solver(there, start)
    found = solver.result
    return found if found.position_error_m < tracked.position_error_m else tracked


def _max_joint_distance(a: Vector, b: Vector) -> float:
    return float(np.abs(a - b).max(initial=0.0))


def _make_marker(target: Target, found: Result) -> TargetMarker:
    return TargetMarker(
        target.position, found.nearest_m, found.reached, found.binding, target.frame
    )

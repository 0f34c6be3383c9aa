"""From wishes to joints: the goal follows the pointer on its own branch, inside the limits.

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
from ikservo.kinematics.se3 import Matrix, Vector, pose
from ikservo.view.drag.wishes import Hold, Pull, Turn, Wish
from ikservo.view.scene.aim import Aim

__all__ = ["AUTO", "LONGEST_RAD", "Answer", "Puppet"]

LONGEST_RAD = math.radians(8.0)
"""The furthest any joint goes in one answer to a drag: the whole step is scaled (lecture L7)."""

_RESTARTS = 12
# A picture's worth of iterations; the pictures that follow go on.
_ITERATIONS, _MORE = 2, 20
_CLICK_ITERATIONS = 120
_STILL_RAD = 1e-5
AUTO = "auto"
"""Goes on along the branch the arm is on, by the production solver."""


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """The goal that a wish leads to.

    Attributes:
        q: Joints (dof,), inside the limits.
        aim: The target and how near the goal comes to it; None where there is none.
        settled: Whether the same wish would lead no further.
        words: What a chosen method has done; empty for ``auto``.
    """

    q: Vector
    aim: Aim | None
    settled: bool = True
    words: str = ""


class Puppet:
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

    def answer(self, wish: Wish, q: Vector) -> Answer:
        """Return the goal for a wish, from joints (dof,) that may lie outside the limits.

        Raises:
            UnknownNameError: The wish names no joint or link of the arm.
        """
        start = self._chain.clip(q)
        if isinstance(wish, Hold):
            return Answer(start, None)
        if isinstance(wish, Turn):
            return Answer(self._turned(wish, start), None)
        return self._pulled(wish, start)

    def _turned(self, wish: Turn, start: Vector) -> Vector:
        if wish.joint not in self._chain.names:
            raise UnknownNameError("joint", wish.joint, self._chain.names)
        q = start.copy()
        q[self._chain.names.index(wish.joint)] = wish.position
        return self._chain.clip(q)

    def _pulled(self, wish: Pull, start: Vector) -> Answer:
        """Return the joints for a point that is pulled, at most one picture's step further."""
        if self.method != AUTO and not wish.jump:
            return self._iterated(wish, start)
        found = self._tracked(wish, start)
        leaning = self._leaning(wish, found)
        if wish.jump:
            return Answer(leaning.q, _aim(wish.target, leaning))
        q, shortened = self._step(start, leaning.q)
        settled = not shortened and _apart(leaning.q, found.q) < _STILL_RAD
        return Answer(q, _aim(wish.target, found), settled)

    def _tracked(self, wish: Pull, start: Vector) -> Result:
        """Go on along the branch the arm is on; a click may look for another way to fold."""
        solver, there = self._prepared(wish.target), pose(wish.target.position)
        solver.track(there, start)
        found = solver.result
        return _nearer(found, solver, there, start) if wish.jump and not found.reached else found

    def _leaning(self, wish: Pull, found: Result) -> Result:
        """Go some way towards the posture without leaving the target."""
        posture = self._posture_before(wish.target)
        if posture is None or not found.reached:
            return found
        count = _CLICK_ITERATIONS if wish.jump else _ITERATIONS
        walked = solve(
            self._chain, wish.target, found.q, "pseudo_inverse",
            posture=posture, max_iterations=count, trace=True,
        ).trace[-1]  # fmt: skip
        solver = self._prepared(wish.target)
        solver.track(pose(wish.target.position), walked)  # a few steps leave the target a little
        leaning = solver.result
        return leaning if leaning.reached else found

    def _iterated(self, wish: Pull, start: Vector) -> Answer:
        """Let the chosen method go on from where the arm is; the next picture goes on again."""
        posture = self._posture_before(wish.target)
        for count in (_ITERATIONS, _MORE):  # an error may grow at first and then come down
            found = solve(
                self._chain, wish.target, start, self.method,
                restarts=1, max_iterations=count, posture=posture,
            )  # fmt: skip
            if _apart(found.q, start) > _STILL_RAD:
                break
        q, shortened = self._step(start, found.q)
        settled = not shortened and (found.reached or _apart(found.q, start) <= _STILL_RAD)
        if posture is not None and self.method == "pseudo_inverse":
            settled = _apart(found.q, start) <= _STILL_RAD
        words = f"{found.method}: {found.position_error_m * 1000:.1f} mm left"
        return Answer(q, _aim(wish.target, found), settled, words)

    def _posture_before(self, target: Target) -> Posture | None:
        """Return the posture for the joints that move the target's frame; the others stay."""
        if self.posture is None or target.frame is None:
            return self.posture
        moving = {step.column for step in self._chain.way(target.frame) if step.scale}
        weights = np.array(self.posture.weights, dtype=np.float64)
        weights[[i for i in range(self._chain.dof) if i not in moving]] = 0.0
        return Posture(self.posture.q, weights)

    def _step(self, start: Vector, q: Vector) -> tuple[Vector, bool]:
        """Return joints at most 8° from the start on the way to q, and whether that is short."""
        longest = _apart(q, start)
        if longest <= LONGEST_RAD:
            return q, False
        return self._chain.clip(start + (q - start) * (LONGEST_RAD / longest)), True

    def _prepared(self, target: Target) -> Solver:
        """Return the solver for the point that is pulled; that of one drag is kept."""
        offset = None if target.offset_m is None else np.asarray(target.offset_m, np.float64)
        name = b"" if offset is None else offset.tobytes()
        if self._kept is None or self._kept[:2] != (target.frame, name):
            options = Options(restarts=_RESTARTS)
            solver = Solver(self._chain, frame=target.frame, offset_m=offset, options=options)
            self._kept = (target.frame, name, solver)
        return self._kept[2]


def _nearer(tracked: Result, solver: Solver, there: Matrix, start: Vector) -> Result:
    """Return what a search from many starts finds, where that comes nearer."""
    solver(there, start)
    found = solver.result
    return found if found.position_error_m < tracked.position_error_m else tracked


def _apart(a: Vector, b: Vector) -> float:
    return float(np.abs(a - b).max(initial=0.0))


def _aim(target: Target, found: Result) -> Aim:
    return Aim(target.position, found.nearest_m, found.reached, found.binding, target.frame)

"""From wishes to joints: the goal follows the pointer on its own branch, inside the limits.

::

    puppet = Puppet(chain)
    answer = puppet.answer(wish, q_goal)          # q_goal: the goal so far, or where the arm is
    q_goal = answer.q                             # once more with the same wish until settled
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ikservo.errors import UnknownNameError
from ikservo.ik import Options, Result, Solver, Target
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector, pose
from ikservo.view.drag.wishes import Hold, Pull, Turn, Wish
from ikservo.view.scene.aim import Aim

__all__ = ["LONGEST_RAD", "Answer", "Puppet"]

LONGEST_RAD = math.radians(8.0)
"""The furthest any joint goes in one answer to a drag: the whole step is scaled (lecture L7)."""

_RESTARTS = 12


@dataclass(frozen=True, slots=True, eq=False)
class Answer:
    """The goal that a wish leads to.

    Attributes:
        q: Joints (dof,), inside the limits.
        aim: The target and how near the goal comes to it; None where there is none.
        settled: Whether the same wish would lead no further.
    """

    q: Vector
    aim: Aim | None
    settled: bool = True


class Puppet:
    """Answers wishes; the joints beyond a grabbed link stay as they are.

    Args:
        chain: The arm, inside its own limits.
    """

    def __init__(self, chain: Chain) -> None:
        self._chain = chain
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
        """Go on along the branch the arm is on; a click may look for another way to fold."""
        solver, there = self._prepared(wish.target), pose(wish.target.position)
        solver.track(there, start)
        found = solver.result
        if wish.jump:
            found = found if found.reached else _nearer(found, solver, there, start)
            return Answer(found.q, _aim(wish.target, found))
        step = found.q - start
        longest = float(np.abs(step).max(initial=0.0))
        if longest <= LONGEST_RAD:
            return Answer(found.q, _aim(wish.target, found))
        q = self._chain.clip(start + step * (LONGEST_RAD / longest))
        return Answer(q, _aim(wish.target, found), settled=False)

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


def _aim(target: Target, found: Result) -> Aim:
    return Aim(target.position, found.nearest_m, found.reached, found.binding, target.frame)

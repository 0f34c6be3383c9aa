"""Iteration in small steps (lecture L7): the loop that the lecture's methods share."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np

from ikservo.ik.answer import answer
from ikservo.ik.options import Options, Tolerance
from ikservo.ik.result import Result
from ikservo.ik.task import Local, Task
from ikservo.kinematics.se3 import Vector

__all__ = ["SMALL", "Step", "downhill", "iterate", "small"]

SMALL = math.radians(2.0)
"""The longest step of a joint: 2°, and for a slide as many metres (35 mm)."""

# A step this small moves the tool by less than a nanometre.
_STEP_END = 1e-9
# A walk that has come neither a thousandth nor a micrometre closer for so long goes in circles.
_PATIENCE, _PROGRESS, _PROGRESS_M = 50, 0.999, 1e-6
# A step halved so often is lost in the rounding of the error.
_HALVINGS = 40

Step = Callable[[Local], Local]
"""One iteration of a method: from the error here to the error where it steps."""


def small(step: Vector) -> Vector:
    """Return the step (dof,), scaled as a whole so that no joint goes further than 2° (L7)."""
    largest = float(np.abs(step).max(initial=0.0))
    return step if largest <= SMALL else step * (SMALL / largest)


def downhill(task: Task, here: Local, step: Vector) -> Local:
    """Go the step (dof,) or the longest half, quarter, … of it that makes nothing worse."""
    for _ in range(_HALVINGS):
        there = task.at(task.chain.clip(here.q + step))
        if there.cost <= here.cost:
            return there
        step = 0.5 * step
    return here


def iterate(
    method: str,
    step: Step,
    task: Task,
    q0: Vector,
    options: Options,
    max_iterations: int,
    *,
    settle: bool = False,
) -> Result:
    """Step from ``q0`` until the target is met, nothing moves any more or patience ends (L7).

    One walk without restarts: as in the lecture it goes on from where the arm is, and where it
    gets stuck it says so. The answer is the best iterate.

    Args:
        method: The method's name, for the result.
        step: What the method does in one iteration.
        task: What is wanted of which chain.
        q0: Start (dof,), rad or m; one outside the limits is first put onto them.
        options: Tolerance, iterations at most, whether to keep them.
        max_iterations: Iterations at most where the options leave it to the method.
        settle: Whether to go on after the target is met, until nothing moves.
    """
    walk = _Walk(task, options.tolerance, task.at(task.chain.clip(q0)))
    for _ in range(options.max_iterations or max_iterations):
        if walk.over(settle=settle):
            break
        walk.go(step(walk.here))
    return answer(
        task.chain,
        task.target,
        walk.best.q,
        options.tolerance,
        method=method,
        iterations=len(walk.trace) - 1,
        trace=tuple(walk.trace) if options.trace else (),
    )


class _Walk:
    """Where a walk is, where it was best, and how long it has not come closer."""

    def __init__(self, task: Task, tolerance: Tolerance, start: Local) -> None:
        self.here = self.best = start
        self.trace = [start.q]
        self._task, self._tolerance = task, tolerance
        self._met = task.met(start, tolerance)
        self._still, self._mark_m, self._since = False, math.sqrt(start.cost), 0

    def over(self, *, settle: bool) -> bool:
        return self._still or self._since > _PATIENCE or (self._met and not settle)

    def go(self, there: Local) -> None:
        self._still = float(np.abs(there.q - self.here.q).max()) <= _STEP_END
        self._met = self._task.met(there, self._tolerance)
        if self._met or there.cost < self.best.cost:
            self.best = there
        left_m = math.sqrt(there.cost)
        if self._met or left_m < max(_PROGRESS * self._mark_m, self._mark_m - _PROGRESS_M):
            self._mark_m, self._since = left_m, 0
        else:
            self._since += 1
        self.here = there
        self.trace.append(there.q)

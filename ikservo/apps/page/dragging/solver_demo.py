"""The planar demonstration of solver methods, iteration by iteration.

::

    model = load_model("planar3")                     # or any flat arm
    trace = trace_method(model.chain, target_m, q0, "ccd")
    trace.page_fields                                 # drawn by the page, sent once
    for k in range(trace.count):
        text = trace.format_step(k)                   # "ccd, iteration 12 of 40: 3.2 mm left"

Every method starts at the same joints, inside the same limits, and has the same stopping
criterion, so that they can be compared on one target.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ikservo.ik import METHODS, Posture, Result, Target, solve
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector

SOLVERS: tuple[str, ...] = tuple(METHODS)
"""The methods that the user can choose."""

ITERATIVE = ("pseudo_inverse", "transpose", "ccd")
"""Methods that iterate from the current joints and may end short of the nearest point."""

_MAX_SHOWN = 200
_DIGITS = 5


@dataclass(frozen=True, eq=False)
class SolverTrace:
    """The iterations of a method towards a target.

    Attributes:
        result: The result of the method.
        target_m: Target (3,), metres.
        numbers: The iteration of each shown step (count,); long traces are thinned evenly.
        lines_m: The arm at each shown step (count, points, 3), base to tip, metres.
    """

    result: Result
    target_m: Vector
    numbers: tuple[int, ...]
    lines_m: Matrix

    @property
    def count(self) -> int:
        """Number of steps to show, including the start."""
        return len(self.numbers)

    def distance_left_m(self, step: int) -> float:
        """Compute the distance from the tip to the target at a step."""
        return math.dist(self.lines_m[step, -1], self.target_m)

    @cached_property
    def page_fields(self) -> dict[str, object]:
        """Fields that the page draws step by step; see ``page/static/marks.js``."""
        return {
            "lines": np.round(self.lines_m, _DIGITS).tolist(),
            "target": self.target_m.tolist(),
            "reached": self.result.reached,
        }

    def format_step(self, step: int) -> str:
        """Format the iteration number of a step, and the remaining distance, as text."""
        left = f"{self.distance_left_m(step) * 1000:.1f} mm left"
        return f"{self.result.method}, iteration {self.numbers[step]} of {self.numbers[-1]}: {left}"


def trace_method(
    chain: Chain,
    target_m: ArrayLike,
    q0: ArrayLike,
    method: str,
    posture: Posture | None = None,
) -> SolverTrace:
    """Solve for a target (3,) [m] from q0 (dof,) with one of ``SOLVERS``; record its iterations.

    Raises:
        UnknownNameError: There is no such method.
        BadValueError: The target or q0 is invalid.
    """
    target = Target(target_m)
    result = solve(chain, target, q0, method, trace=True, restarts=1, posture=posture)
    steps = np.array(result.trace or (chain.clip(q0), result.q))
    shown = np.unique(np.linspace(0, len(steps) - 1, min(len(steps), _MAX_SHOWN)).round())
    numbers = shown.astype(int)
    # The pivots and the tip (n, points, 3) at joints (n, dof).
    q = steps[numbers]
    links = [step.joint.child for step in chain.joints_to() if step.scale]
    points = [chain.forward(q, link)[:, :3, 3] for link in (*links, chain.tip)]
    return SolverTrace(
        result=result,
        target_m=target.position,
        numbers=tuple(numbers.tolist()),
        lines_m=np.stack(points, axis=1),
    )

"""The planar demonstration of solver methods, iteration by iteration.

::

    model = load_model("planar3")                     # or any flat arm
    trace = trace_method(model.chain, target_m, q0, "ccd")
    for k in range(trace.count):
        items = trace.items(k, camera)                # painted over SceneRenderer(model).draw(…)
        text = trace.format_step(k)                   # "ccd, iteration 12 of 40: 3.2 mm left"

Every method starts at the same joints, inside the same limits, and has the same stopping
criterion, so that they can be compared on one target.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.ik import METHODS, Posture, Result, Target, solve
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.view.camera import Camera
from ikservo.view.draw_items import DrawItem, circle, cross, polyline

__all__ = ["ITERATIVE", "SOLVERS", "SolverTrace", "trace_method"]

SOLVERS: tuple[str, ...] = tuple(METHODS)
"""The methods to choose from."""

ITERATIVE = ("pseudo_inverse", "transpose", "ccd")
"""Methods that iterate from the current joints: they need not end at the nearest point."""

_MAX_SHOWN = 200
_TRAIL = 10
_JOINT_PX, _CROSS_PX = 4.0, 9.0


@dataclass(frozen=True, slots=True, eq=False)
class SolverTrace:
    """The iterations of a method towards a target.

    Attributes:
        result: Its result.
        target_m: The target (3,), metres.
        numbers: The iteration of each shown step (count,); long traces are thinned evenly.
        lines_m: The arm at each shown step (count, points, 3), base to tip, metres.
    """

    result: Result
    target_m: Vector
    numbers: tuple[int, ...]
    lines_m: Matrix

    @property
    def count(self) -> int:
        """Return how many steps there are to show, the start included."""
        return len(self.numbers)

    def distance_left_m(self, step: int) -> float:
        """Return the distance of the tip from the target at a step."""
        return math.dist(self.lines_m[step, -1], self.target_m)

    def items(self, step: int, camera: Camera) -> list[DrawItem]:
        """Return the items of a step: the arm over earlier ones, the tip's path, the target."""
        px, _ = camera.project(self.lines_m[: step + 1])
        at, _ = camera.project(self.target_m)
        last = step == self.count - 1
        style = "target" if not last or self.result.reached else "target_far"
        return [
            *(polyline("iteration", line) for line in px[:: max(1, len(px) // _TRAIL)]),
            polyline("trace", px[:, -1]),
            polyline("gap", [px[-1, -1], at]),
            polyline("iterate", px[-1]),
            *(circle("joint", joint, _JOINT_PX) for joint in px[-1, :-1]),
            circle("tip", px[-1, -1], _JOINT_PX),
            cross(style, at, _CROSS_PX),
        ]

    def format_step(self, step: int) -> str:
        """Return the iteration number of a step, and the remaining distance, as text."""
        left = f"{self.distance_left_m(step) * 1000:.1f} mm left"
        return f"{self.result.method}, iteration {self.numbers[step]} of {self.numbers[-1]}: {left}"


def trace_method(
    chain: Chain,
    target_m: ArrayLike,
    q0: ArrayLike,
    method: str,
    posture: Posture | None = None,
) -> SolverTrace:
    """Solve for a target with a method and record its iterations.

    Args:
        chain: The arm.
        target_m: The target of the tip (3,), metres.
        q0: The start (dof,).
        method: One of ``SOLVERS``.
        posture: Preferred posture, if the method has a null space.

    Raises:
        UnknownNameError: There is no such method.
        BadValueError: The target or q0 is invalid.
    """
    target = Target(target_m)
    result = solve(chain, target, q0, method, trace=True, restarts=1, posture=posture)
    steps = np.array(result.trace or (chain.clip(q0), result.q))
    shown = np.unique(np.linspace(0, len(steps) - 1, min(len(steps), _MAX_SHOWN)).round())
    numbers = shown.astype(int)
    return SolverTrace(
        result=result,
        target_m=target.position,
        numbers=tuple(numbers.tolist()),
        lines_m=_arm_points(chain, steps[numbers]),
    )


def _arm_points(chain: Chain, q: Matrix) -> Matrix:
    """Return the pivots and the tip (n, points, 3) at joints (n, dof)."""
    links = [step.joint.child for step in chain.joints_to() if step.scale]
    points = [chain.forward(q, link)[:, :3, 3] for link in (*links, chain.tip)]
    return np.stack(points, axis=1)

"""The public questions: solve once, or prepare a solver for a loop."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError, UnknownNameError
from ikservo.ik.bounded import Descent, descend
from ikservo.ik.result import Binding, Result, Tolerance
from ikservo.ik.seeds import seeds
from ikservo.ik.target import Target
from ikservo.kinematics import Chain, finite_vector
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["METHODS", "Solver", "solve"]

_RESTARTS = 40
# One radian weighs like a lever of this length, about half of a small arm.
_TURN_WEIGHT_M_RAD = 0.1
_FULL_POSE_DOF = 6


def solve(
    chain: Chain,
    target: Target,
    q0: ArrayLike | None = None,
    method: str = "auto",
    *,
    tolerance: Tolerance | None = None,
    restarts: int = _RESTARTS,
) -> Result:
    """Find joints inside the limits that bring the point to the target (lecture L5, L13).

    With fewer than six joints the position comes first: it is met exactly where the limits
    allow, and the orientation as well as what remains allows.

    Args:
        chain: The arm; its limits are never left, not even by one ulp.
        target: What is wanted.
        q0: Where to start (dof,), rad or m; may lie outside the limits. The middle if None.
        method: ``auto`` or one of ``METHODS``.
        tolerance: How close counts as reached.
        restarts: How many starting points to try at most, the given one first.

    Returns:
        The solution, or the nearest point that was found and the limits that bind there.

    Raises:
        BadValueError: q0 has a wrong shape or is not finite.
        UnknownNameError: No such method, or the target's frame is no link of the arm.
    """
    if restarts < 1:
        raise BadValueError("restarts", restarts, "at least 1")
    start = chain.middle() if q0 is None else finite_vector(q0, chain.dof, "q0")
    return _method(method)(chain, target, start, tolerance or Tolerance(), restarts)


class Solver:
    """A question prepared once and asked in a loop, always from where the arm is.

    Calls never restart, so that neighbouring targets get neighbouring joints.
    """

    def __init__(
        self,
        chain: Chain,
        kind: Literal["position", "direction", "pose"] = "position",
        *,
        tool_axis: ArrayLike = (0.0, 0.0, 1.0),
        tolerance: Tolerance | None = None,
    ) -> None:
        if kind not in ("position", "direction", "pose"):
            raise UnknownNameError("kind of target", kind, ("position", "direction", "pose"))
        self.chain, self.kind = chain, kind
        self._tool_axis = finite_vector(tool_axis, 3, "tool_axis")
        self._tolerance = tolerance or Tolerance()

    def __call__(self, T_world_tool: Matrix, q0: ArrayLike) -> tuple[Vector, bool]:
        """Return joints (dof,) for the pose (4, 4) from ``q0`` (dof,), and whether they reach."""
        result = solve(
            self.chain, self._target(T_world_tool), q0, tolerance=self._tolerance, restarts=1
        )
        return result.q, result.reached

    def _target(self, T: Matrix) -> Target:
        if self.kind == "pose":
            return Target(T[:3, 3], orientation=T[:3, :3])
        if self.kind == "direction":
            direction = T[:3, :3] @ self._tool_axis
            return Target(T[:3, 3], direction=direction, tool_axis=self._tool_axis)
        return Target(T[:3, 3])


def _bounded(
    chain: Chain, target: Target, q0: Vector, tolerance: Tolerance, restarts: int
) -> Result:
    """Descend from one seed after another until one reaches; else answer with the closest."""
    best: Result | None = None
    iterations = 0
    for seed in seeds(chain, q0, restarts):
        descent = _descend_by_priority(chain, target, seed)
        iterations += descent.iterations
        found = _judge(chain, target, descent, tolerance, iterations)
        if best is None or _rank(found, tolerance) < _rank(best, tolerance):
            best = found
        if best.reached:
            break
    assert best is not None  # noqa: S101  # restarts >= 1 was checked
    return replace(best, iterations=iterations)


METHODS: dict[str, Callable[[Chain, Target, Vector, Tolerance, int], Result]] = {
    "bounded": _bounded,
}


def _method(name: str) -> Callable[[Chain, Target, Vector, Tolerance, int], Result]:
    if name == "auto":
        return _bounded
    try:
        return METHODS[name]
    except KeyError:
        raise UnknownNameError("method", name, ("auto", *METHODS)) from None


def _descend_by_priority(chain: Chain, target: Target, seed: Vector) -> Descent:
    descent = descend(chain, target, seed, _TURN_WEIGHT_M_RAD)
    if target.only_position or chain.dof >= _FULL_POSE_DOF:
        return descent
    # Position first: from the best compromise walk to the nearest joints that meet the point.
    met = descend(chain, target, descent.q, 0.0)
    return Descent(met.q, met.gradient, descent.iterations + met.iterations)


def _judge(
    chain: Chain, target: Target, descent: Descent, tolerance: Tolerance, iterations: int
) -> Result:
    T = chain.forward(descent.q, target.frame, target.offset_m)
    position_error_m = _norm(target.position - T[:3, 3])
    orientation_error_rad = _norm(target.turn_left(T[:3, :3]))
    reached = (
        position_error_m <= tolerance.position_m
        and orientation_error_rad <= tolerance.orientation_rad
    )
    return Result(
        q=descent.q,
        reached=reached,
        position_error_m=position_error_m,
        orientation_error_rad=orientation_error_rad,
        binding=() if reached else _binding(chain, descent),
        iterations=iterations,
        nearest_m=T[:3, 3],
        method="bounded",
    )


def _binding(chain: Chain, descent: Descent) -> tuple[Binding, ...]:
    """Name the joints that stand at a limit and would go on if they could."""
    found: list[Binding] = []
    for i, name in enumerate(chain.names):
        if descent.q[i] <= chain.lower_rad[i] and descent.gradient[i] > 0:
            found.append(Binding(name, "lower"))
        elif descent.q[i] >= chain.upper_rad[i] and descent.gradient[i] < 0:
            found.append(Binding(name, "upper"))
    return tuple(found)


def _rank(result: Result, tolerance: Tolerance) -> tuple[float, float]:
    """Order results: the position first, and among equal positions the orientation."""
    beyond_m = max(0.0, result.position_error_m - tolerance.position_m)
    return beyond_m, result.orientation_error_rad


def _norm(v: Vector) -> float:
    return math.sqrt(float(np.dot(v, v)))

"""Evaluate a configuration against a target: errors, active limits, result."""

from __future__ import annotations

import math

import numpy as np

from ikservo.ik.problem import Target, Tolerance
from ikservo.ik.result import ActiveLimit, Result
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector

__all__ = ["evaluate", "is_closer"]


def evaluate(
    chain: Chain,
    target: Target,
    q: Vector,
    tolerance: Tolerance,
    *,
    method: str,
    iterations: int,
    trace: tuple[Vector, ...] = (),
) -> Result:
    """Return what joints (dof,) inside the limits are worth against a target."""
    T, J = chain.forward_and_jacobian(q, target.frame, target.offset_m)
    gap_m, turn_rad = target.position - T[:3, 3], target.orientation_error(T[:3, :3])
    position_error_m, orientation_error_rad = _vector_norm(gap_m), _vector_norm(turn_rad)
    met = position_error_m <= tolerance.position_m
    reached = met and orientation_error_rad <= tolerance.orientation_rad
    pull = J[3:].T @ turn_rad if met else J[:3].T @ gap_m
    return Result(
        q=q,
        reached=reached,
        position_error_m=position_error_m,
        orientation_error_rad=orientation_error_rad,
        binding=() if reached else _binding_limits(chain, q, pull),
        iterations=iterations,
        nearest_m=T[:3, 3],
        method=method,
        trace=trace,
    )


def is_closer(a: Result, b: Result, tolerance: Tolerance) -> bool:
    """Return whether a is the better answer: by position first, then by orientation."""
    return _rank_result(a, tolerance) < _rank_result(b, tolerance)


def _rank_result(result: Result, tolerance: Tolerance) -> tuple[float, float]:
    return max(0.0, result.position_error_m - tolerance.position_m), result.orientation_error_rad


def _binding_limits(chain: Chain, q: Vector, pull: Vector) -> tuple[ActiveLimit, ...]:
    """Name the joints that stand at a limit and would go on if they could."""
    found: list[ActiveLimit] = []
    for i, name in enumerate(chain.names):
        if q[i] <= chain.lower_rad[i] and pull[i] < 0:
            found.append(ActiveLimit(name, "lower"))
        elif q[i] >= chain.upper_rad[i] and pull[i] > 0:
            found.append(ActiveLimit(name, "upper"))
    return tuple(found)


def _vector_norm(v: Vector | Matrix) -> float:
    return math.sqrt(float(np.dot(v, v)))

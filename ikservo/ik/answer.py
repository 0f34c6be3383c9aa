"""From joints to an honest answer: measured against the target, whatever method found them."""

from __future__ import annotations

import math

import numpy as np

from ikservo.ik.options import Tolerance
from ikservo.ik.result import Binding, Result
from ikservo.ik.target import Target
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["answer", "closer"]


def answer(
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
    T, J = chain.linearise(q, target.frame, target.offset_m)
    gap_m, turn_rad = target.position - T[:3, 3], target.turn_left(T[:3, :3])
    position_error_m, orientation_error_rad = _norm(gap_m), _norm(turn_rad)
    met = position_error_m <= tolerance.position_m
    reached = met and orientation_error_rad <= tolerance.orientation_rad
    pull = J[3:].T @ turn_rad if met else J[:3].T @ gap_m
    return Result(
        q=q,
        reached=reached,
        position_error_m=position_error_m,
        orientation_error_rad=orientation_error_rad,
        binding=() if reached else _binding(chain, q, pull),
        iterations=iterations,
        nearest_m=T[:3, 3],
        method=method,
        trace=trace,
    )


def closer(a: Result, b: Result, tolerance: Tolerance) -> bool:
    """Return whether a is the better answer: by position first, then by orientation."""
    return _rank(a, tolerance) < _rank(b, tolerance)


def _rank(result: Result, tolerance: Tolerance) -> tuple[float, float]:
    return max(0.0, result.position_error_m - tolerance.position_m), result.orientation_error_rad


def _binding(chain: Chain, q: Vector, pull: Vector) -> tuple[Binding, ...]:
    """Name the joints that stand at a limit and would go on if they could."""
    found: list[Binding] = []
    for i, name in enumerate(chain.names):
        if q[i] <= chain.lower_rad[i] and pull[i] < 0:
            found.append(Binding(name, "lower"))
        elif q[i] >= chain.upper_rad[i] and pull[i] > 0:
            found.append(Binding(name, "upper"))
    return tuple(found)


def _norm(v: Vector | Matrix) -> float:
    return math.sqrt(float(np.dot(v, v)))

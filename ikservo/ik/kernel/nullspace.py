"""Descent in the null space, along the set of solutions."""

from __future__ import annotations

import math

from ikservo.ik.kernel.descent import minimise
from ikservo.ik.kernel.forward_kinematics import converged, evaluate, residual_rows
from ikservo.ik.kernel.jit import jit, jit_inline
from ikservo.ik.kernel.layout import (
    FREE,
    J_WEIGHTED,
    KIND,
    LOWER_LIMIT,
    NORMAL,
    NORMS,
    POS_ERR2,
    Q_BEST,
    RESIDUAL,
    RHS_ERROR,
    ROT_ERR2,
    ROTATION_WEIGHT,
    STEP,
    TOLERANCE_M,
    UPPER_LIMIT,
    Q,
)
from ikservo.ik.kernel.linear_algebra import ldl_factor, ldl_solve
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.packed import DOF

__all__ = ["nullspace_descent"]

_MAX_ITERATIONS, _MAX_STALLED_STEPS, _RADIUS = 30, 4, 0.5
# Steps [rad] for a chord of one, and shares of its square, that are not worth another round.
_STEP_END, _GAIN_END = 1e-4, 1e-6
# Where a limit keeps the position from being met quite, this share of the tolerance will do.
_POSITION_MARGIN = 0.5
# A joint that is this near its limit would end every step too soon.
_AT_LIMIT = 1e-5
# Turns that move the joints far for little are damped by this share of the squared weight.
_DAMPING, _FLOOR, _TINY = 1e-3, 1e-13, 1e-300


@jit
def nullspace_descent(
    arm: Matrix, question: Vector, settings: Vector, trace: Matrix, desk: Matrix
) -> int:
    """Turn the tool towards what is wanted while its position stays; return the steps taken.

    Q stands where the position is met, or as near as can be. Every round goes a step along which
    the position stays to first order, walks back to it, and counts if the tool has turned.
    """
    n, kind, weight = int(arm[0, DOF]), int(settings[KIND]), settings[ROTATION_WEIGHT]
    near2 = max(desk[NORMS, POS_ERR2], (_POSITION_MARGIN * settings[TOLERANCE_M]) ** 2)
    # No chord is longer than 2.
    radius, steps, best = _RADIUS, 0, 5.0
    for _ in range(_MAX_ITERATIONS):
        gain = best - desk[NORMS, ROT_ERR2] if desk[NORMS, POS_ERR2] <= near2 else 0.0
        if gain > 0.0:
            best -= gain
            for j in range(n):
                desk[Q_BEST, j] = desk[Q, j]
            radius = min(2.0 * radius, _RADIUS)
            if gain < _GAIN_END * best or converged(settings, 0.1, desk):
                break
        else:
            for j in range(n):
                desk[Q, j] = desk[Q_BEST, j]
            radius *= 0.25
        evaluate(arm, question, kind, weight, desk)
        longest = _rotation_step(
            residual_rows(kind, weight), _DAMPING * weight * weight, radius, n, desk
        )
        if longest < _STEP_END * math.sqrt(best):
            break
        for j in range(n):
            desk[Q, j] = min(
                max(desk[Q, j] + desk[STEP, j], desk[LOWER_LIMIT, j]), desk[UPPER_LIMIT, j]
            )
        steps += 1 + minimise(arm, question, settings, 0.0, _MAX_STALLED_STEPS, trace, desk)
    for j in range(n):
        desk[Q, j] = desk[Q_BEST, j]
    evaluate(arm, question, kind, weight, desk)
    return steps


@jit_inline
def _rotation_step(rows: int, damping: float, radius: float, n: int, desk: Matrix) -> float:
    """Fill STEP with a turn that leaves the position, up to the first limit; return its length."""
    for j in range(n):
        desk[FREE, j] = 1.0
    for _ in range(n + 1):
        _solve_nullspace_rotation(rows, damping, n, desk)
        if _fix_blocked_joints(n, desk):
            break
    longest = 0.0
    for j in range(n):
        longest = max(longest, abs(desk[STEP, j]))
    scale = radius / longest if longest > radius else 1.0
    for j in range(n):
        way = desk[STEP, j]
        room = (desk[UPPER_LIMIT, j] if way > 0.0 else desk[LOWER_LIMIT, j]) - desk[Q, j]
        if abs(scale * way) > abs(room):
            scale = room / way
    for j in range(n):
        desk[STEP, j] *= scale
    return scale * longest


@jit_inline
def _fix_blocked_joints(n: int, desk: Matrix) -> bool:
    """Hold the joints that stand on a limit and step beyond it; return whether there are none."""
    none = True
    for j in range(n):
        way, q = desk[STEP, j], desk[Q, j]
        above, below = q >= desk[UPPER_LIMIT, j] - _AT_LIMIT, q <= desk[LOWER_LIMIT, j] + _AT_LIMIT
        if (way > 0.0 and above) or (way < 0.0 and below):
            desk[FREE, j], none = 0.0, False
    return none


@jit
def _solve_nullspace_rotation(rows: int, damping: float, n: int, desk: Matrix) -> None:
    """Solve step = Gᵀ (G Gᵀ + D)⁻¹ y for a turn y, with damping of the turn alone in D."""
    trace = 0.0
    for a in range(rows):
        for b in range(a + 1):
            s = 0.0
            for j in range(n):
                s += desk[J_WEIGHTED + a, j] * desk[J_WEIGHTED + b, j] * desk[FREE, j]
            desk[NORMAL + a, b] = s
        trace += desk[NORMAL + a, a]
        desk[NORMAL + a, a] += damping if a >= 3 else 0.0
        desk[RHS_ERROR, a] = desk[RESIDUAL, a] if a >= 3 else 0.0
    if ldl_factor(desk, NORMAL, rows, _FLOOR * trace + _TINY):
        ldl_solve(desk, NORMAL, rows, RHS_ERROR)
    for j in range(n):
        s = 0.0
        for r in range(rows):
            s += desk[J_WEIGHTED + r, j] * desk[RHS_ERROR, r]
        desk[STEP, j] = s * desk[FREE, j]

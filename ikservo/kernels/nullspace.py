"""Minimisation of the orientation error in the null space of the position task."""

from __future__ import annotations

import math

from ikservo.kernels.descent import minimise
from ikservo.kernels.forward_kinematics import converged, evaluate, residual_rows
from ikservo.kernels.layout import (
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
from ikservo.kernels.linear_algebra import ldl_factor, ldl_solve
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.packed import DOF

_MAX_ITERATIONS, _MAX_STALLED_STEPS, _RADIUS = 30, 4, 0.5
# Steps [rad] for a chord of one, and fractions of its square, too small for another iteration.
_STEP_END, _GAIN_END = 1e-4, 1e-6
# If a limit keeps the position from converging fully, this fraction of the tolerance is enough.
_POSITION_MARGIN = 0.5
# A joint this near its limit would shorten every step.
_AT_LIMIT = 1e-5
# Rotations near singular directions are damped by this fraction of the squared weight.
_DAMPING, _FLOOR, _TINY = 1e-3, 1e-13, 1e-300


def nullspace_descent(
    arm: Matrix, problem: Vector, settings: Vector, trace: Matrix, work: Matrix
) -> int:
    """Reduce the orientation error while the position stays; return the number of steps taken.

    Q reaches the target position, or is as near to it as possible. Every iteration takes a step
    along which the position stays to first order, then corrects the position. The result is kept if
    it reduces the orientation error.
    """
    n, kind, weight = int(arm[0, DOF]), int(settings[KIND]), settings[ROTATION_WEIGHT]
    margin_m = _POSITION_MARGIN * settings[TOLERANCE_M]
    near2 = max(work[NORMS, POS_ERR2], margin_m * margin_m)
    # No chord is longer than 2.
    radius, steps, best = _RADIUS, 0, 5.0
    for _ in range(_MAX_ITERATIONS):
        gain = best - work[NORMS, ROT_ERR2] if work[NORMS, POS_ERR2] <= near2 else 0.0
        if gain > 0.0:
            best -= gain
            for j in range(n):
                work[Q_BEST, j] = work[Q, j]
            radius = min(2.0 * radius, _RADIUS)
            if gain < _GAIN_END * best or converged(settings, 0.1, work):
                break
        else:
            for j in range(n):
                work[Q, j] = work[Q_BEST, j]
            radius *= 0.25
        evaluate(arm, problem, kind, weight, work)
        rows, damping = residual_rows(kind, weight), _DAMPING * weight * weight
        longest = _rotation_step(rows, damping, radius, n, work)
        if longest < _STEP_END * math.sqrt(best):
            break
        for j in range(n):
            work[Q, j] = min(
                max(work[Q, j] + work[STEP, j], work[LOWER_LIMIT, j]), work[UPPER_LIMIT, j]
            )
        steps += 1 + minimise(arm, problem, settings, 0.0, _MAX_STALLED_STEPS, trace, work)
    for j in range(n):
        work[Q, j] = work[Q_BEST, j]
    evaluate(arm, problem, kind, weight, work)
    return steps


def _rotation_step(rows: int, damping: float, radius: float, n: int, work: Matrix) -> float:
    """Fill STEP with a rotation at a fixed position, up to the first limit; return its length."""
    for j in range(n):
        work[FREE, j] = 1.0
    for _ in range(n + 1):
        _solve_nullspace_rotation(rows, damping, n, work)
        if _fix_blocked_joints(n, work):
            break
    longest = 0.0
    for j in range(n):
        longest = max(longest, abs(work[STEP, j]))
    scale = radius / longest if longest > radius else 1.0
    for j in range(n):
        step = work[STEP, j]
        margin = (work[UPPER_LIMIT, j] if step > 0.0 else work[LOWER_LIMIT, j]) - work[Q, j]
        if abs(scale * step) > abs(margin):
            scale = margin / step
    for j in range(n):
        work[STEP, j] *= scale
    return scale * longest


def _fix_blocked_joints(n: int, work: Matrix) -> bool:
    """Fix joints at a limit that the step would move beyond it; return whether there are none."""
    none = True
    for j in range(n):
        step, q = work[STEP, j], work[Q, j]
        above, below = q >= work[UPPER_LIMIT, j] - _AT_LIMIT, q <= work[LOWER_LIMIT, j] + _AT_LIMIT
        if (step > 0.0 and above) or (step < 0.0 and below):
            work[FREE, j], none = 0.0, False
    return none


def _solve_nullspace_rotation(rows: int, damping: float, n: int, work: Matrix) -> None:
    """Solve step = Gᵀ (G Gᵀ + D)⁻¹ y for a rotation y; D damps the rows of the rotation only."""
    trace = 0.0
    for a in range(rows):
        for b in range(a + 1):
            s = 0.0
            for j in range(n):
                s += work[J_WEIGHTED + a, j] * work[J_WEIGHTED + b, j] * work[FREE, j]
            work[NORMAL + a, b] = s
        trace += work[NORMAL + a, a]
        work[NORMAL + a, a] += damping if a >= 3 else 0.0
        work[RHS_ERROR, a] = work[RESIDUAL, a] if a >= 3 else 0.0
    if ldl_factor(work, NORMAL, rows, _FLOOR * trace + _TINY):
        ldl_solve(work, NORMAL, rows, RHS_ERROR)
    for j in range(n):
        s = 0.0
        for r in range(rows):
            s += work[J_WEIGHTED + r, j] * work[RHS_ERROR, r]
        work[STEP, j] = s * work[FREE, j]

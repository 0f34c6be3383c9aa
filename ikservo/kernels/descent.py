"""Damped descent with active joint limits.

A joint that the step would move past its limit is placed at the limit, and the step of the other
joints is computed again, until all are inside.
"""

from __future__ import annotations

import math

from ikservo.kernels.forward_kinematics import converged, evaluate, residual_rows
from ikservo.kernels.layout import (
    ACTIVE,
    FREE,
    KIND,
    LOWER_LIMIT,
    MAX_STEPS,
    NEG_GRAD,
    NORMS,
    Q_PREV,
    Q_SAVED,
    ROT_ERR2,
    STEP,
    TRACE_LEN,
    TRACK,
    UPPER_LIMIT,
    Q,
)
from ikservo.kernels.linear_algebra import least_norm, least_squares, newton_step
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.packed import DOF, FULL_TURN, LOWER, STEPS, UPPER

# A curvature below -_FLAT of the largest is negative; above it is rounding in a flat direction.
_FLAT = 1e-7
# The joints' steps add up to at most this [rad]: the tip of a long chain whose joints all turn a
# little would otherwise go round in a circle. Six joints never reach it.
_FULL_STEP = 5.0


def update_free_set(n: int, work: Matrix) -> float:
    """Free the joints that no limit blocks; return the largest slope among them."""
    steepest = 0.0
    for j in range(n):
        slope, q = work[NEG_GRAD, j], work[Q, j]
        blocked = (q <= work[LOWER_LIMIT, j] and slope < 0.0) or (
            q >= work[UPPER_LIMIT, j] and slope > 0.0
        )
        work[FREE, j] = 0.0 if blocked else 1.0
        work[STEP, j] = 0.0
        if not blocked:
            steepest = max(steepest, abs(slope))
    return steepest


def descent_step(
    problem: Vector,
    kind: int,
    weight: float,
    newton: bool,
    damping: float,
    radius: float,
    n: int,
    work: Matrix,
) -> float:
    """Fill STEP and return its largest entry; call ``evaluate`` and ``update_free_set`` first.

    The step of the free joints is scaled to ``radius`` as a whole (lecture L7), so that its
    direction does not change.
    """
    rows = residual_rows(kind, weight)
    for _ in range(n + 1):
        if newton:
            newton_step(problem, kind, weight, n, work)
        elif rows < n:
            least_norm(rows, damping, n, work)
        else:
            least_squares(rows, damping, n, work)
        if _scale_into_limits(radius, n, work):
            break
    longest = 0.0
    for j in range(n):
        longest = max(longest, abs(work[STEP, j]))
    return longest


def has_negative_curvature(problem: Vector, kind: int, weight: float, n: int, work: Matrix) -> bool:
    """Check whether the Hessian of the free joints is indefinite: a saddle or a maximum."""
    return newton_step(problem, kind, weight, n, work) > _FLAT


def _scale_into_limits(radius: float, n: int, work: Matrix) -> bool:
    """Scale the free joints' step; fix joints that would leave their limits; True if none would."""
    longest, total = 0.0, 0.0
    for j in range(n):
        if work[FREE, j] == 1.0:
            longest = max(longest, abs(work[STEP, j]))
            total += abs(work[STEP, j])
    scale = radius / longest if longest > radius else 1.0
    if scale * total > _FULL_STEP:
        scale = _FULL_STEP / total
    inside = True
    for j in range(n):
        if work[FREE, j] == 1.0:
            work[STEP, j] *= scale
            q, lower, upper = work[Q, j], work[LOWER_LIMIT, j], work[UPPER_LIMIT, j]
            new = q + work[STEP, j]
            if new < lower or new > upper:
                work[STEP, j] = (lower if new < lower else upper) - q
                work[FREE, j] = 0.0
                inside = False
    return inside


# Trust radius of the linear model [rad]; tracking takes shorter steps, to stay on its branch.
_RADIUS, _RADIUS_WHEN_TRACKING = 0.8, 0.5
# Damping of singular directions, as a fraction of the squared error: it vanishes with the error, so
# that convergence stays quadratic (Levenberg-Marquardt after Fan and Yuan 2005).
_DAMPING = 0.1
# A step that reduces the squared error by less than this fraction approaches a non-zero minimum,
# where second derivatives matter (Fletcher and Xu 1987). Other steps do not use second derivatives,
# because those mislead in nearly flat valleys.
_SLOW = 0.15
# Solutions are refined to this fraction of the tolerance; smaller steps and slopes count as zero.
_FINE, _STEP_END, _SLOPE_END = 1e-3, 1e-11, 1e-12
_PERTURBATION_RAD, _MAX_PERTURBATIONS = 0.02, 3
_GOLDEN_RATIO = 0.6180339887498949
# With more joints than this second derivatives cost more time than the steps they save.
_MAX_NEWTON_JOINTS = 60


def minimise(
    arm: Matrix,
    problem: Vector,
    settings: Vector,
    weight: float,
    max_stalled: int,
    trace: Matrix,
    work: Matrix,
) -> int:
    """Descend from Q and leave the result in Q; return the number of steps tried.

    Stops at convergence, at a stationary point, after ``max_stalled`` consecutive slow steps or
    after the settings' MAX_STEPS.
    """
    n, kind = int(arm[0, DOF]), int(settings[KIND])
    widest = _RADIUS_WHEN_TRACKING if settings[TRACK] == 1.0 else _RADIUS
    cost, radius, longest, undone = math.inf, widest, 0.0, False
    steps, perturbations, slow, saved_cost = 0, 0, 0, math.inf
    while True:
        new_cost = evaluate(arm, problem, kind, weight, work)
        if new_cost < cost:
            slow = slow + 1 if new_cost > (1.0 - _SLOW) * cost else 0
            radius = min(2.0 * radius, widest)
            cost = new_cost
            _record_trace(n, trace, work)
        elif not undone:
            if converged(settings, 1.0, work) and new_cost < cost * (1.0 + 1e-6) + 1e-18:
                break  # as accurate as rounding allows
            _copy_row(Q_PREV, Q, n, work)
            slow += 1
            radius = 0.25 * longest
            undone = True
            continue
        undone = False
        if (
            steps >= settings[MAX_STEPS]
            or slow >= max_stalled
            or _is_stationary(settings, weight, work)
        ):
            break
        steps += 1
        longest = 0.0
        if update_free_set(n, work) > _SLOPE_END:
            newton, damping = slow % 2 == 1 and n <= _MAX_NEWTON_JOINTS, _DAMPING * 2.0 * cost
            longest = descent_step(problem, kind, weight, newton, damping, radius, n, work)
        if longest > _STEP_END:
            _apply_step(n, work)
        elif (
            perturbations < _MAX_PERTURBATIONS
            and n <= _MAX_NEWTON_JOINTS
            and has_negative_curvature(problem, kind, weight, n, work)
        ):
            perturbations += 1
            if cost < saved_cost:
                saved_cost = cost
                _copy_row(Q, Q_SAVED, n, work)
            cost, radius = math.inf, widest
            _perturb_joints(n, work)
        else:
            break
    if saved_cost < cost:  # the perturbation did not improve the result
        _copy_row(Q_SAVED, Q, n, work)
        evaluate(arm, problem, kind, weight, work)
    return steps


def _is_stationary(settings: Vector, weight: float, work: Matrix) -> bool:
    """Check whether the residual is fully refined; with a weight of 0 only the position counts."""
    if weight > 0.0:
        return converged(settings, _FINE, work)
    chord2 = work[NORMS, ROT_ERR2]
    work[NORMS, ROT_ERR2] = 0.0
    fine = converged(settings, _FINE, work)
    work[NORMS, ROT_ERR2] = chord2
    return fine


def _apply_step(n: int, work: Matrix) -> None:
    """Add the step to Q; joints that rounding moves past a limit are placed at the limit."""
    for j in range(n):
        work[Q_PREV, j] = work[Q, j]
        work[Q, j] = min(
            max(work[Q, j] + work[STEP, j], work[LOWER_LIMIT, j]), work[UPPER_LIMIT, j]
        )


def _copy_row(source: int, to: int, n: int, work: Matrix) -> None:
    for j in range(n):
        work[to, j] = work[source, j]


def _perturb_joints(n: int, work: Matrix) -> None:
    """Leave a saddle: turn every free joint slightly, with irregular signs."""
    for j in range(n):
        if work[FREE, j] == 1.0:
            fraction = j * _GOLDEN_RATIO
            side = 1.0 if fraction - math.floor(fraction) < 0.5 else -1.0
            q = work[Q, j] + side * _PERTURBATION_RAD / (1.0 + j)
            if q < work[LOWER_LIMIT, j] or q > work[UPPER_LIMIT, j]:
                q = work[Q, j] - side * _PERTURBATION_RAD / (1.0 + j)
            work[Q, j] = min(max(q, work[LOWER_LIMIT, j]), work[UPPER_LIMIT, j])


def _record_trace(n: int, trace: Matrix, work: Matrix) -> None:
    """Append Q to the trace, if there is room."""
    row = int(work[NORMS, TRACE_LEN])
    if row < len(trace) // 2:
        for j in range(n):
            trace[row, j] = work[Q, j]
        work[NORMS, TRACE_LEN] = row + 1.0


_TURN = 2.0 * math.pi
_AT_LIMIT = 1e-6


def set_bounds(arm: Matrix, free_turns: bool, work: Matrix) -> None:
    """Fill LOWER_LIMIT and UPPER_LIMIT and clip Q to them.

    With ``free_turns``, joints whose range is a full turn have no limits during the search.
    """
    first = int(arm[0, STEPS]) + 2
    for j in range(int(arm[0, DOF])):
        free = free_turns and arm[first + j, FULL_TURN] == 1.0
        work[LOWER_LIMIT, j] = -math.inf if free else arm[first + j, LOWER]
        work[UPPER_LIMIT, j] = math.inf if free else arm[first + j, UPPER]
        work[Q, j] = min(max(work[Q, j], work[LOWER_LIMIT, j]), work[UPPER_LIMIT, j])


def wrap_full_turns(arm: Matrix, start: Vector, work: Matrix) -> bool:
    """Bring full-turn joints into their range, as near the start as possible.

    Returns whether a joint was clipped, because its range is not quite a full turn.
    """
    first, clipped = int(arm[0, STEPS]) + 2, False
    for j in range(int(arm[0, DOF])):
        if arm[first + j, FULL_TURN] == 0.0:
            continue
        lower, upper = arm[first + j, LOWER], arm[first + j, UPPER]
        q = work[Q, j] + _TURN * math.floor((start[j] - work[Q, j]) / _TURN + 0.5)
        if q > upper:
            q -= _TURN * math.ceil((q - upper) / _TURN)
        elif q < lower:
            q += _TURN * math.ceil((lower - q) / _TURN)
        if q < lower or q > upper:  # outside a range that is not quite a full turn
            q += _TURN * math.floor((0.5 * (lower + upper) - q) / _TURN + 0.5)
        work[Q, j] = min(max(q, lower), upper)
        clipped = clipped or work[Q, j] != q
    return clipped


def mark_active_limits(n: int, work: Matrix) -> None:
    """Fill ACTIVE with the limits that block the descent."""
    for j in range(n):
        work[ACTIVE, j] = 0.0
        if work[Q, j] <= work[LOWER_LIMIT, j] + _AT_LIMIT and work[NEG_GRAD, j] < 0.0:
            work[ACTIVE, j] = -1.0
        elif work[Q, j] >= work[UPPER_LIMIT, j] - _AT_LIMIT and work[NEG_GRAD, j] > 0.0:
            work[ACTIVE, j] = 1.0

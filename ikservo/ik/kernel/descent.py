"""Damped descent with active joint limits.

A joint that the step would carry past its limit is set on it, and the others are solved again
for what is left, until none leaves.
"""

from __future__ import annotations

import math

from ikservo.ik.kernel.forward_kinematics import converged, evaluate, residual_rows
from ikservo.ik.kernel.jit import jit, jit_inline
from ikservo.ik.kernel.layout import (
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
from ikservo.ik.kernel.linear_algebra import least_norm, least_squares, newton_step
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.packed import DOF, FULL_TURN, LOWER, STEPS, UPPER

__all__ = [
    "descent_step",
    "has_negative_curvature",
    "mark_active_limits",
    "minimise",
    "set_bounds",
    "update_free_set",
    "wrap_full_turns",
]


# A curvature beyond -_FLAT of the largest is a way down and no flat valley.
_FLAT = 1e-7
# All joints together turn no more than this [rad] in a step: the tip of a long chain, whose joints
# go a little each, would come round a circle. Six joints never do.
_FULL_STEP = 5.0


@jit_inline
def update_free_set(n: int, desk: Matrix) -> float:
    """Free the joints that no limit holds; return the steepest pull among them."""
    steepest = 0.0
    for j in range(n):
        pull, q = desk[NEG_GRAD, j], desk[Q, j]
        held = (q <= desk[LOWER_LIMIT, j] and pull < 0.0) or (
            q >= desk[UPPER_LIMIT, j] and pull > 0.0
        )
        desk[FREE, j] = 0.0 if held else 1.0
        desk[STEP, j] = 0.0
        if not held:
            steepest = max(steepest, abs(pull))
    return steepest


@jit_inline
def descent_step(
    question: Vector,
    kind: int,
    weight: float,
    bent: bool,
    damping: float,
    radius: float,
    n: int,
    desk: Matrix,
) -> float:
    """Fill STEP and return its largest entry; ``look`` and ``release`` come before.

    The step of the free joints is scaled to ``radius`` as a whole (lecture L7), so that its
    direction stays.
    """
    rows = residual_rows(kind, weight)
    for _ in range(n + 1):
        if bent:
            newton_step(question, kind, weight, n, desk)
        elif rows < n:
            least_norm(rows, damping, n, desk)
        else:
            least_squares(rows, damping, n, desk)
        if _scale_into_limits(radius, n, desk):
            break
    longest = 0.0
    for j in range(n):
        longest = max(longest, abs(desk[STEP, j]))
    return longest


@jit
def has_negative_curvature(
    question: Vector, kind: int, weight: float, n: int, desk: Matrix
) -> bool:
    """Return whether the free joints stand on a saddle or a top: some way leads down."""
    return newton_step(question, kind, weight, n, desk) > _FLAT


@jit_inline
def _scale_into_limits(radius: float, n: int, desk: Matrix) -> bool:
    """Scale the free joints' step; set those that leave their limits on them and return False."""
    longest, whole = 0.0, 0.0
    for j in range(n):
        if desk[FREE, j] == 1.0:
            longest = max(longest, abs(desk[STEP, j]))
            whole += abs(desk[STEP, j])
    scale = radius / longest if longest > radius else 1.0
    if scale * whole > _FULL_STEP:
        scale = _FULL_STEP / whole
    inside = True
    for j in range(n):
        if desk[FREE, j] == 1.0:
            desk[STEP, j] *= scale
            there = desk[Q, j] + desk[STEP, j]
            if there < desk[LOWER_LIMIT, j] or there > desk[UPPER_LIMIT, j]:
                end = desk[LOWER_LIMIT, j] if there < desk[LOWER_LIMIT, j] else desk[UPPER_LIMIT, j]
                desk[STEP, j] = end - desk[Q, j]
                desk[FREE, j] = 0.0
                inside = False
    return inside


# The linear model is good for about this far; tracking stays nearer, and so on its branch.
_RADIUS, _RADIUS_ON_TRACK = 0.8, 0.5
# Damping against singular directions, as a share of the squared error: it vanishes where the
# error does, so that the last steps are Newton's (Levenberg-Marquardt after Fan and Yuan 2005).
_DAMPING = 0.1
# A step that takes less than this share of the squared error off meets a minimum that is not
# zero: from there on curvature matters (Fletcher and Xu 1987). Every other step stays without it,
# for it is blind to valleys that are nearly flat.
_SLOW = 0.3
# Solutions are refined to this share of the tolerance; a step or pull this small is none.
_FINE, _STEP_END, _PULL_END = 1e-3, 1e-11, 1e-12
_PERTURBATION_RAD, _MAX_PERTURBATIONS = 0.02, 3
# Second derivatives of more joints than this cost more than the steps that they save.
_MANY = 60


@jit
def minimise(
    arm: Matrix,
    question: Vector,
    settings: Vector,
    weight: float,
    patience: int,
    trace: Matrix,
    desk: Matrix,
) -> int:
    """Walk from Q; leave the end on the desk; return the number of steps tried.

    Stops when the target is met, when no free joint has a way down, when ``patience`` steps were
    slow one after another, or after the budget.
    """
    n, kind = int(arm[0, DOF]), int(settings[KIND])
    widest = _RADIUS_ON_TRACK if settings[TRACK] == 1.0 else _RADIUS
    half, radius, longest, back = math.inf, widest, 0.0, False
    steps, nudges, slow, kept = 0, 0, 0, math.inf
    while True:
        there = evaluate(arm, question, kind, weight, desk)
        if there < half:
            slow = slow + 1 if there > (1.0 - _SLOW) * half else 0
            radius = min(2.0 * radius, widest)
            half = there
            _record_trace(n, trace, desk)
        elif not back:
            if converged(settings, 1.0, desk) and there < half * (1.0 + 1e-6) + 1e-18:
                break  # as good as rounding allows
            _copy_row(Q_PREV, Q, n, desk)
            slow += 1
            radius = 0.25 * longest
            back = True
            continue
        back = False
        if (
            steps >= settings[MAX_STEPS]
            or slow >= patience
            or _is_stationary(settings, weight, desk)
        ):
            break
        steps += 1
        longest = 0.0
        if update_free_set(n, desk) > _PULL_END:
            newton, damping = slow % 2 == 1 and n <= _MANY, _DAMPING * 2.0 * half
            longest = descent_step(question, kind, weight, newton, damping, radius, n, desk)
        if longest > _STEP_END:
            _apply_step(n, desk)
        elif (
            nudges < _MAX_PERTURBATIONS
            and n <= _MANY
            and has_negative_curvature(question, kind, weight, n, desk)
        ):
            nudges += 1
            if half < kept:
                kept = half
                _copy_row(Q, Q_SAVED, n, desk)
            half, radius = math.inf, widest
            _perturb_joints(n, desk)
        else:
            break
    if kept < half:  # a nudge that led nowhere better
        _copy_row(Q_SAVED, Q, n, desk)
        evaluate(arm, question, kind, weight, desk)
    return steps


@jit_inline
def _is_stationary(settings: Vector, weight: float, desk: Matrix) -> bool:
    """Return whether going on would gain nothing; a weight of 0 looks at the position only."""
    if weight > 0.0:
        return converged(settings, _FINE, desk)
    chord2 = desk[NORMS, ROT_ERR2]
    desk[NORMS, ROT_ERR2] = 0.0
    fine = converged(settings, _FINE, desk)
    desk[NORMS, ROT_ERR2] = chord2
    return fine


@jit_inline
def _apply_step(n: int, desk: Matrix) -> None:
    """Take the step; what rounding carries past a limit is set on it."""
    for j in range(n):
        desk[Q_PREV, j] = desk[Q, j]
        desk[Q, j] = min(
            max(desk[Q, j] + desk[STEP, j], desk[LOWER_LIMIT, j]), desk[UPPER_LIMIT, j]
        )


@jit_inline
def _copy_row(source: int, to: int, n: int, desk: Matrix) -> None:
    for j in range(n):
        desk[to, j] = desk[source, j]


@jit
def _perturb_joints(n: int, desk: Matrix) -> None:
    """Leave a saddle: turn every free joint a little, in directions that have no pattern."""
    for j in range(n):
        if desk[FREE, j] == 1.0:
            side = 1.0 if (j * 0.6180339887498949) % 1.0 < 0.5 else -1.0
            there = desk[Q, j] + side * _PERTURBATION_RAD / (1.0 + j)
            if there < desk[LOWER_LIMIT, j] or there > desk[UPPER_LIMIT, j]:
                there = desk[Q, j] - side * _PERTURBATION_RAD / (1.0 + j)
            desk[Q, j] = min(max(there, desk[LOWER_LIMIT, j]), desk[UPPER_LIMIT, j])


@jit_inline
def _record_trace(n: int, trace: Matrix, desk: Matrix) -> None:
    """Write the present joints down, if there is room."""
    row = int(desk[NORMS, TRACE_LEN])
    if row < len(trace) // 2:
        for j in range(n):
            trace[row, j] = desk[Q, j]
        desk[NORMS, TRACE_LEN] = row + 1.0


_TURN = 2.0 * math.pi
_AT_LIMIT = 1e-6


@jit_inline
def set_bounds(arm: Matrix, free_turns: bool, desk: Matrix) -> None:
    """Fill LOW and HIGH and move Q inside.

    Joints whose range is a full turn have no limits while the search goes on.
    """
    first = int(arm[0, STEPS]) + 2
    for j in range(int(arm[0, DOF])):
        free = free_turns and arm[first + j, FULL_TURN] == 1.0
        desk[LOWER_LIMIT, j] = -math.inf if free else arm[first + j, LOWER]
        desk[UPPER_LIMIT, j] = math.inf if free else arm[first + j, UPPER]
        desk[Q, j] = min(max(desk[Q, j], desk[LOWER_LIMIT, j]), desk[UPPER_LIMIT, j])


@jit_inline
def wrap_full_turns(arm: Matrix, start: Vector, desk: Matrix) -> bool:
    """Bring full-turn joints into their range, as near the start as can be.

    Returns True where a joint fell into the gap of a range that is not quite a full turn.
    """
    first, clipped = int(arm[0, STEPS]) + 2, False
    for j in range(int(arm[0, DOF])):
        if arm[first + j, FULL_TURN] == 0.0:
            continue
        lower, upper = arm[first + j, LOWER], arm[first + j, UPPER]
        q = desk[Q, j] + _TURN * math.floor((start[j] - desk[Q, j]) / _TURN + 0.5)
        if q > upper:
            q -= _TURN * math.ceil((q - upper) / _TURN)
        elif q < lower:
            q += _TURN * math.ceil((lower - q) / _TURN)
        desk[Q, j] = min(max(q, lower), upper)
        clipped = clipped or desk[Q, j] != q
    return clipped


@jit
def mark_active_limits(n: int, desk: Matrix) -> None:
    """Write down the limits that the descent pressed against."""
    for j in range(n):
        desk[ACTIVE, j] = 0.0
        if desk[Q, j] <= desk[LOWER_LIMIT, j] + _AT_LIMIT and desk[NEG_GRAD, j] < 0.0:
            desk[ACTIVE, j] = -1.0
        elif desk[Q, j] >= desk[UPPER_LIMIT, j] - _AT_LIMIT and desk[NEG_GRAD, j] > 0.0:
            desk[ACTIVE, j] = 1.0

"""Walk downhill from one starting point to a solution or a local minimum (lecture L7, L13)."""

from __future__ import annotations

import math

from ikservo.ik.kernel.compiling import inlined, inner
from ikservo.ik.kernel.desk import BACK, CHORD2, FREE, GAUGE, HIGH, KEPT, LOW, NOTED, STEP, Q
from ikservo.ik.kernel.layout import BUDGET, KIND, TRACK
from ikservo.ik.kernel.looking import look, met
from ikservo.ik.kernel.stepping import curves_down, downhill, release
from ikservo.kinematics.packing import DOF
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["descend"]

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
_NUDGE, _NUDGES = 0.02, 3
# Second derivatives of more joints than this cost more than the steps that they save.
_MANY = 60


@inner
def descend(
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
        there = look(arm, question, kind, weight, desk)
        if there < half:
            slow = slow + 1 if there > (1.0 - _SLOW) * half else 0
            radius = min(2.0 * radius, widest)
            half = there
            _note(n, trace, desk)
        elif not back:
            if met(settings, 1.0, desk) and there < half * (1.0 + 1e-6) + 1e-18:
                break  # as good as rounding allows
            _copy(BACK, Q, n, desk)
            slow += 1
            radius = 0.25 * longest
            back = True
            continue
        back = False
        if steps >= settings[BUDGET] or slow >= patience or _is_fine(settings, weight, desk):
            break
        steps += 1
        longest = 0.0
        if release(n, desk) > _PULL_END:
            newton, damping = slow % 2 == 1 and n <= _MANY, _DAMPING * 2.0 * half
            longest = downhill(question, kind, weight, newton, damping, radius, n, desk)
        if longest > _STEP_END:
            _go(n, desk)
        elif nudges < _NUDGES and n <= _MANY and curves_down(question, kind, weight, n, desk):
            nudges += 1
            if half < kept:
                kept = half
                _copy(Q, KEPT, n, desk)
            half, radius = math.inf, widest
            _nudge(n, desk)
        else:
            break
    if kept < half:  # a nudge that led nowhere better
        _copy(KEPT, Q, n, desk)
        look(arm, question, kind, weight, desk)
    return steps


@inlined
def _is_fine(settings: Vector, weight: float, desk: Matrix) -> bool:
    """Return whether going on would gain nothing; a weight of 0 looks at the position only."""
    if weight > 0.0:
        return met(settings, _FINE, desk)
    chord2 = desk[GAUGE, CHORD2]
    desk[GAUGE, CHORD2] = 0.0
    fine = met(settings, _FINE, desk)
    desk[GAUGE, CHORD2] = chord2
    return fine


@inlined
def _go(n: int, desk: Matrix) -> None:
    """Take the step; what rounding carries past a limit is set on it."""
    for j in range(n):
        desk[BACK, j] = desk[Q, j]
        desk[Q, j] = min(max(desk[Q, j] + desk[STEP, j], desk[LOW, j]), desk[HIGH, j])


@inlined
def _copy(source: int, to: int, n: int, desk: Matrix) -> None:
    for j in range(n):
        desk[to, j] = desk[source, j]


@inner
def _nudge(n: int, desk: Matrix) -> None:
    """Leave a saddle: turn every free joint a little, in directions that have no pattern."""
    for j in range(n):
        if desk[FREE, j] == 1.0:
            side = 1.0 if (j * 0.6180339887498949) % 1.0 < 0.5 else -1.0
            there = desk[Q, j] + side * _NUDGE / (1.0 + j)
            if there < desk[LOW, j] or there > desk[HIGH, j]:
                there = desk[Q, j] - side * _NUDGE / (1.0 + j)
            desk[Q, j] = min(max(there, desk[LOW, j]), desk[HIGH, j])


@inlined
def _note(n: int, trace: Matrix, desk: Matrix) -> None:
    """Write the present joints down, if there is room."""
    row = int(desk[GAUGE, NOTED])
    if row < len(trace) // 2:
        for j in range(n):
            trace[row, j] = desk[Q, j]
        desk[GAUGE, NOTED] = row + 1.0

"""Slide where the position stays: the null space of the position turns the tool (lecture L10)."""

from __future__ import annotations

import math

from ikservo.ik.kernel.compiling import inlined, inner
from ikservo.ik.kernel.descending import descend
from ikservo.ik.kernel.desk import (
    BEST,
    CHORD2,
    ERROR,
    FREE,
    GAP2,
    GAUGE,
    HIGH,
    LOW,
    NORMAL,
    STEP,
    G,
    Q,
    Y,
)
from ikservo.ik.kernel.layout import KIND, TOLERANCE_M, TURN_WEIGHT
from ikservo.ik.kernel.linear import factor, substitute
from ikservo.ik.kernel.looking import look, met, rows_of
from ikservo.kinematics.packing import DOF
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["slide"]

_ROUNDS, _PATIENCE, _RADIUS = 30, 4, 0.5
# Steps [rad] for a chord of one, and shares of its square, that are not worth another round.
_STEP_END, _GAIN_END = 1e-4, 1e-6
# Where a limit keeps the position from being met quite, this share of the tolerance will do.
_SLACK = 0.5
# A joint that is this near its limit would end every step too soon.
_AT_LIMIT = 1e-5
# Turns that move the joints far for little are damped by this share of the squared weight.
_DAMPING, _FLOOR, _TINY = 1e-3, 1e-13, 1e-300


@inner
def slide(arm: Matrix, question: Vector, settings: Vector, trace: Matrix, desk: Matrix) -> int:
    """Turn the tool towards what is wanted while its position stays; return the steps taken.

    Q stands where the position is met, or as near as can be. Every round goes a step along which
    the position stays to first order, walks back to it, and counts if the tool has turned.
    """
    n, kind, weight = int(arm[0, DOF]), int(settings[KIND]), settings[TURN_WEIGHT]
    near2 = max(desk[GAUGE, GAP2], (_SLACK * settings[TOLERANCE_M]) ** 2)
    # No chord is longer than 2.
    radius, steps, best = _RADIUS, 0, 5.0
    for _ in range(_ROUNDS):
        gain = best - desk[GAUGE, CHORD2] if desk[GAUGE, GAP2] <= near2 else 0.0
        if gain > 0.0:
            best -= gain
            for j in range(n):
                desk[BEST, j] = desk[Q, j]
            radius = min(2.0 * radius, _RADIUS)
            if gain < _GAIN_END * best or met(settings, 0.1, desk):
                break
        else:
            for j in range(n):
                desk[Q, j] = desk[BEST, j]
            radius *= 0.25
        look(arm, question, kind, weight, desk)
        longest = _turn(rows_of(kind, weight), _DAMPING * weight * weight, radius, n, desk)
        if longest < _STEP_END * math.sqrt(best):
            break
        for j in range(n):
            desk[Q, j] = min(max(desk[Q, j] + desk[STEP, j], desk[LOW, j]), desk[HIGH, j])
        steps += 1 + descend(arm, question, settings, 0.0, _PATIENCE, trace, desk)
    for j in range(n):
        desk[Q, j] = desk[BEST, j]
    look(arm, question, kind, weight, desk)
    return steps


@inlined
def _turn(rows: int, damping: float, radius: float, n: int, desk: Matrix) -> float:
    """Fill STEP with a turn that leaves the position, up to the first limit; return its length."""
    for j in range(n):
        desk[FREE, j] = 1.0
    for _ in range(n + 1):
        _without_moving(rows, damping, n, desk)
        if _none_pushes(n, desk):
            break
    longest = 0.0
    for j in range(n):
        longest = max(longest, abs(desk[STEP, j]))
    scale = radius / longest if longest > radius else 1.0
    for j in range(n):
        way = desk[STEP, j]
        room = (desk[HIGH, j] if way > 0.0 else desk[LOW, j]) - desk[Q, j]
        if abs(scale * way) > abs(room):
            scale = room / way
    for j in range(n):
        desk[STEP, j] *= scale
    return scale * longest


@inlined
def _none_pushes(n: int, desk: Matrix) -> bool:
    """Hold the joints that stand on a limit and step beyond it; return whether there are none."""
    none = True
    for j in range(n):
        way, q = desk[STEP, j], desk[Q, j]
        above, below = q >= desk[HIGH, j] - _AT_LIMIT, q <= desk[LOW, j] + _AT_LIMIT
        if (way > 0.0 and above) or (way < 0.0 and below):
            desk[FREE, j], none = 0.0, False
    return none


@inner
def _without_moving(rows: int, damping: float, n: int, desk: Matrix) -> None:
    """Solve step = Gᵀ (G Gᵀ + D)⁻¹ y for a turn y, with damping of the turn alone in D."""
    trace = 0.0
    for a in range(rows):
        for b in range(a + 1):
            s = 0.0
            for j in range(n):
                s += desk[G + a, j] * desk[G + b, j] * desk[FREE, j]
            desk[NORMAL + a, b] = s
        trace += desk[NORMAL + a, a]
        desk[NORMAL + a, a] += damping if a >= 3 else 0.0
        desk[Y, a] = desk[ERROR, a] if a >= 3 else 0.0
    if factor(desk, NORMAL, rows, _FLOOR * trace + _TINY):
        substitute(desk, NORMAL, rows, Y)
    for j in range(n):
        s = 0.0
        for r in range(rows):
            s += desk[G + r, j] * desk[Y, r]
        desk[STEP, j] = s * desk[FREE, j]

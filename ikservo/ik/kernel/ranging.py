"""The limits as a search respects them, and the way back from full turns into the range."""

from __future__ import annotations

import math

from ikservo.ik.kernel.compiling import inlined, inner
from ikservo.ik.kernel.desk import HELD, HIGH, LOW, PULL, Q
from ikservo.kinematics.packing import DOF, FULL_TURN, LOWER, STEPS, UPPER
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["fence", "fold", "hold"]

_TURN = 2.0 * math.pi
_AT_LIMIT = 1e-6


@inlined
def fence(arm: Matrix, free_turns: bool, desk: Matrix) -> None:
    """Fill LOW and HIGH and move Q inside.

    Joints whose range is a full turn have no limits while the search goes on.
    """
    first = int(arm[0, STEPS]) + 2
    for j in range(int(arm[0, DOF])):
        free = free_turns and arm[first + j, FULL_TURN] == 1.0
        desk[LOW, j] = -math.inf if free else arm[first + j, LOWER]
        desk[HIGH, j] = math.inf if free else arm[first + j, UPPER]
        desk[Q, j] = min(max(desk[Q, j], desk[LOW, j]), desk[HIGH, j])


@inlined
def fold(arm: Matrix, start: Vector, desk: Matrix) -> bool:
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


@inner
def hold(n: int, desk: Matrix) -> None:
    """Write down the limits that the descent pressed against."""
    for j in range(n):
        desk[HELD, j] = 0.0
        if desk[Q, j] <= desk[LOW, j] + _AT_LIMIT and desk[PULL, j] < 0.0:
            desk[HELD, j] = -1.0
        elif desk[Q, j] >= desk[HIGH, j] - _AT_LIMIT and desk[PULL, j] > 0.0:
            desk[HELD, j] = 1.0

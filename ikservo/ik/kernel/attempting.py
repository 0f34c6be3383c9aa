"""Attempts: a quick one to find a solution, a thorough one to find the nearest there is."""

from __future__ import annotations

from ikservo.ik.kernel.compiling import inner
from ikservo.ik.kernel.descending import descend
from ikservo.ik.kernel.desk import GAP2, GAUGE, NOTED, SHIFT, TOOL
from ikservo.ik.kernel.layout import (
    KIND,
    POSITION_ONLY,
    PRIORITY,
    TOLERANCE_M,
    TRACK,
    TURN_WEIGHT,
    WANTED_POSITION,
)
from ikservo.ik.kernel.looking import met
from ikservo.ik.kernel.ranging import fence, fold, hold
from ikservo.kinematics.packing import DOF
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["attempt"]

_ROUNDS = 8
# With priority the orientation pulls this much less than by weights, lest it leave the position.
_GENTLE = 0.04


@inner
def attempt(
    arm: Matrix,
    question: Vector,
    settings: Vector,
    start: Vector,
    patience: int,
    thorough: bool,
    placing: bool,
    trace: Matrix,
    desk: Matrix,
) -> int:
    """Walk from Q towards the target and end inside the limits; return the steps.

    When placing, only the position counts. A thorough attempt with priority puts the position
    first, by the method of multipliers: what is missing is added to the target until the pull of
    the orientation no longer moves the tool away from it; then the position alone is met exactly.
    """
    n, weight, steps = int(arm[0, DOF]), settings[TURN_WEIGHT], 0
    free_turns = settings[TRACK] == 0.0 and not thorough
    first = thorough and settings[PRIORITY] == 1.0 and settings[KIND] != POSITION_ONLY
    desk[GAUGE, NOTED] = 0.0
    _forget_shift(desk)
    if first or placing:
        weight = 0.0
    for turn in range(_ROUNDS + 2):
        fence(arm, free_turns, desk)
        steps += descend(arm, question, settings, weight, patience, trace, desk)
        if free_turns:
            free_turns = False
            if fold(arm, start, desk):
                continue  # once more, with the gap of a range that is not quite a full turn
        if weight > 0.0 or not first:
            hold(n, desk)
        if not first or (turn > 0 and weight == 0.0) or met(settings, 1.0, desk):
            break
        near = desk[GAUGE, GAP2] <= (0.01 * settings[TOLERANCE_M]) ** 2
        if turn == _ROUNDS or (turn > 0 and near):
            weight = 0.0
            _forget_shift(desk)
        else:
            weight = _GENTLE * settings[TURN_WEIGHT]
            for r in range(3):
                desk[SHIFT, r] += question[WANTED_POSITION + r] - desk[TOOL, 9 + r]
    return steps


@inner
def _forget_shift(desk: Matrix) -> None:
    desk[SHIFT, 0], desk[SHIFT, 1], desk[SHIFT, 2] = 0.0, 0.0, 0.0

"""Attempts: a quick one to find a solution, a thorough one to find the nearest there is."""

from __future__ import annotations

from ikservo.ik.kernel.compiling import inner
from ikservo.ik.kernel.descending import descend
from ikservo.ik.kernel.desk import GAUGE, NOTED
from ikservo.ik.kernel.layout import KIND, POSITION_ONLY, PRIORITY, TRACK, TURN_WEIGHT
from ikservo.ik.kernel.looking import met
from ikservo.ik.kernel.ranging import fence, fold, hold
from ikservo.ik.kernel.sliding import slide
from ikservo.kinematics.packing import DOF
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["attempt"]


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
    first and then turns the tool where that leaves the position alone.
    """
    n, weight, steps = int(arm[0, DOF]), settings[TURN_WEIGHT], 0
    free_turns = settings[TRACK] == 0.0 and not thorough
    first = thorough and settings[PRIORITY] == 1.0 and settings[KIND] != POSITION_ONLY
    desk[GAUGE, NOTED] = 0.0
    if first or placing:
        weight = 0.0
    fence(arm, free_turns, desk)
    steps += descend(arm, question, settings, weight, patience, trace, desk)
    if free_turns and fold(arm, start, desk):
        # once more, with the gap of a range that is not quite a full turn
        fence(arm, False, desk)
        steps += descend(arm, question, settings, weight, patience, trace, desk)
    if first and not met(settings, 1.0, desk):
        steps += slide(arm, question, settings, trace, desk)
    hold(n, desk)
    return steps

"""Which seed promises most: the one where the tool already stands nearest what is wanted."""

from __future__ import annotations

import math

from ikservo.ik.kernel.compiling import inner
from ikservo.ik.kernel.desk import ENDS
from ikservo.ik.kernel.layout import (
    DIRECTION,
    KIND,
    POSITION_ONLY,
    RESTARTS,
    TURN_WEIGHT,
    WANTED_POSITION,
    WANTED_ROTATION,
)
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["judge", "most_promising"]


@inner
def judge(question: Vector, settings: Vector, seeds: Matrix, n: int, desk: Matrix) -> None:
    """Write down the squared error at every seed; see ``layout`` for the rows of ``seeds``."""
    kind, weight2 = int(settings[KIND]), settings[TURN_WEIGHT] ** 2
    step = 3 if kind == DIRECTION else 1
    for k in range(1, int(settings[RESTARTS])):
        error = 0.0
        for r in range(3):
            error += (question[WANTED_POSITION + r] - seeds[k - 1, n + 9 + r]) ** 2
        if kind != POSITION_ONLY:
            chord2 = 0.0
            for r in range(2 if kind == DIRECTION else 0, 9, step):
                chord2 += (question[WANTED_ROTATION + r] - seeds[k - 1, n + r]) ** 2
            error += weight2 * chord2 * (1.0 if kind == DIRECTION else 0.5)
        desk[ENDS + n + k, n + 1] = error


@inner
def most_promising(settings: Vector, n: int, desk: Matrix) -> int:
    """Return the number of the best seed that was not tried yet, and cross it out."""
    best = 1
    for k in range(2, int(settings[RESTARTS])):
        if desk[ENDS + n + k, n + 1] < desk[ENDS + n + best, n + 1]:
            best = k
    desk[ENDS + n + best, n + 1] = math.inf
    return best

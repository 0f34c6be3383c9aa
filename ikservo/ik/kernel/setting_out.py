"""Where each attempt sets out from, and where the quick ones ended."""

from __future__ import annotations

import math

from ikservo.ik.kernel.compiling import inner
from ikservo.ik.kernel.desk import CHORD2, ENDS, GAP2, GAUGE, Q
from ikservo.ik.kernel.judging import judge, most_promising
from ikservo.ik.kernel.layout import (
    KIND,
    POSITION_ONLY,
    PRIORITY,
    RESTARTS,
    TOLERANCE_M,
    TRACK,
    TURN_WEIGHT,
)
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["MORE", "QUICK", "THOROUGH", "clear_ends", "keep_end", "set_out"]

QUICK, MORE, THOROUGH = 0, 1, 2
# How far a hop leaves the best end towards a seed.
_HOP = 0.35
# With priority ends that miss the position come after all that meet it.
_FAR = 1e6


@inner
def set_out(
    question: Vector,
    settings: Vector,
    start: Vector,
    seeds: Matrix,
    phase: int,
    k: int,
    n: int,
    desk: Matrix,
) -> int:
    """Put Q on the starting point of attempt k; return the number of the seed it comes from."""
    if phase == QUICK or settings[TRACK] == 1.0:
        if k == 1:
            judge(question, settings, seeds, n, desk)
        seed = 0 if k == 0 else most_promising(settings, n, desk)
        _stand_on_seed(start, seeds, seed, n, desk)
        return seed
    if phase == THOROUGH:
        seed = _best_end(settings, n, desk)
        _stand_on_end(seed, n, desk)
        desk[ENDS + n + seed, n] = math.inf
        return seed
    if settings[PRIORITY] == 1.0 and settings[KIND] != POSITION_ONLY:
        return _place_again(settings, start, seeds, k, n, desk)
    _hop(settings, start, seeds, k, n, desk)
    return k


@inner
def clear_ends(restarts: int, n: int, desk: Matrix) -> None:
    """Forget where the attempts of the question before ended."""
    for k in range(restarts):
        desk[ENDS + n + k, n] = math.inf


@inner
def keep_end(settings: Vector, placing: bool, seed: int, n: int, desk: Matrix) -> None:
    """Note where a quick attempt ended, unless that seed has led somewhere better."""
    row = ENDS + n + seed
    error = desk[GAUGE, GAP2] + settings[TURN_WEIGHT] ** 2 * desk[GAUGE, CHORD2]
    if placing and desk[GAUGE, GAP2] > settings[TOLERANCE_M] ** 2:
        error += _FAR
    if error < desk[row, n]:
        for j in range(n):
            desk[row, j] = desk[Q, j]
        desk[row, n] = error


@inner
def _place_again(
    settings: Vector, start: Vector, seeds: Matrix, k: int, n: int, desk: Matrix
) -> int:
    """Stand on every end, then on every seed; the ends by weights no longer count."""
    restarts = int(settings[RESTARTS])
    if k >= restarts:
        _stand_on_seed(start, seeds, k - restarts, n, desk)
        return k - restarts
    _stand_on_end(k, n, desk)
    desk[ENDS + n + k, n] = math.inf
    return k


@inner
def _hop(settings: Vector, start: Vector, seeds: Matrix, k: int, n: int, desk: Matrix) -> None:
    """Stand between the best end and a seed."""
    _stand_on_seed(start, seeds, k, n, desk)
    best = ENDS + n + _best_end(settings, n, desk)
    for j in range(n):
        desk[Q, j] = desk[best, j] + _HOP * (desk[Q, j] - desk[best, j])


@inner
def _stand_on_seed(start: Vector, seeds: Matrix, k: int, n: int, desk: Matrix) -> None:
    for j in range(n):
        desk[Q, j] = start[j] if k == 0 else seeds[k - 1, j]


@inner
def _stand_on_end(k: int, n: int, desk: Matrix) -> None:
    for j in range(n):
        desk[Q, j] = desk[ENDS + n + k, j]


@inner
def _best_end(settings: Vector, n: int, desk: Matrix) -> int:
    best = 0
    for k in range(1, int(settings[RESTARTS])):
        if desk[ENDS + n + k, n] < desk[ENDS + n + best, n]:
            best = k
    return best

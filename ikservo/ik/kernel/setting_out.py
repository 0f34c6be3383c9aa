"""Where each attempt sets out from, and where the quick ones ended."""

from __future__ import annotations

import math

from ikservo.ik.kernel.compiling import inlined, inner
from ikservo.ik.kernel.desk import CHORD2, ENDS, ERRORS, GAP2, GAUGE, SCORES, Q
from ikservo.ik.kernel.judging import judge, most_promising, swing
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

__all__ = ["MORE", "QUICK", "THOROUGH", "clear_ends", "keep_end", "scores_on", "set_out"]

QUICK, MORE, THOROUGH = 0, 1, 2
# How far a hop leaves the best end towards a seed.
_HOP = 0.35
# With priority ends that miss the position come after all that meet it.
_FAR = 1e6


@inner
def set_out(
    arm: Matrix,
    question: Vector,
    settings: Vector,
    start: Vector,
    seeds: Matrix,
    phase: int,
    k: int,
    n: int,
    scores: Matrix,
    desk: Matrix,
) -> int:
    """Put Q on the starting point of attempt k; return the number of the seed it comes from."""
    if phase == QUICK or settings[TRACK] == 1.0:
        if k == 1:
            judge(arm, question, settings, seeds, n, scores)
        seed = 0 if k == 0 else most_promising(settings, scores)
        _stand_on_seed(start, seeds, seed, n, desk)
        if k > 0:
            swing(arm, seeds, seed, n, scores, desk)
        return seed
    if phase == THOROUGH:
        seed = _best_end(settings, scores)
        _stand_on_end(seed, n, desk)
        scores[ERRORS, seed] = math.inf
        return seed
    if settings[PRIORITY] == 1.0 and settings[KIND] != POSITION_ONLY:
        return _place_again(settings, start, seeds, k, n, scores, desk)
    _hop(settings, start, seeds, k, n, scores, desk)
    return k


@inlined
def scores_on(n: int, restarts: int, desk: Matrix) -> Matrix:
    """Return the part of the desk (4, restarts) where seeds and ends are scored."""
    flat, first = desk.reshape(desk.size), (ENDS + n + restarts) * desk.shape[1]
    return flat[first : first + SCORES * restarts].reshape((SCORES, restarts))


@inlined
def clear_ends(restarts: int, scores: Matrix) -> None:
    """Forget where the attempts of the question before ended."""
    for k in range(restarts):
        scores[ERRORS, k] = math.inf


@inner
def keep_end(
    settings: Vector, placing: bool, seed: int, n: int, scores: Matrix, desk: Matrix
) -> None:
    """Note where a quick attempt ended, unless that seed has led somewhere better."""
    row = ENDS + n + seed
    error = desk[GAUGE, GAP2] + settings[TURN_WEIGHT] ** 2 * desk[GAUGE, CHORD2]
    if placing and desk[GAUGE, GAP2] > settings[TOLERANCE_M] ** 2:
        error += _FAR
    if error < scores[ERRORS, seed]:
        for j in range(n):
            desk[row, j] = desk[Q, j]
        scores[ERRORS, seed] = error


@inner
def _place_again(
    settings: Vector,
    start: Vector,
    seeds: Matrix,
    k: int,
    n: int,
    scores: Matrix,
    desk: Matrix,
) -> int:
    """Stand on every end, then on every seed; the ends by weights no longer count."""
    restarts = int(settings[RESTARTS])
    if k >= restarts:
        _stand_on_seed(start, seeds, k - restarts, n, desk)
        return k - restarts
    _stand_on_end(k, n, desk)
    scores[ERRORS, k] = math.inf
    return k


@inner
def _hop(
    settings: Vector,
    start: Vector,
    seeds: Matrix,
    k: int,
    n: int,
    scores: Matrix,
    desk: Matrix,
) -> None:
    """Stand between the best end and a seed."""
    _stand_on_seed(start, seeds, k, n, desk)
    best = ENDS + n + _best_end(settings, scores)
    for j in range(n):
        desk[Q, j] = desk[best, j] + _HOP * (desk[Q, j] - desk[best, j])


@inlined
def _stand_on_seed(start: Vector, seeds: Matrix, k: int, n: int, desk: Matrix) -> None:
    for j in range(n):
        desk[Q, j] = start[j] if k == 0 else seeds[j, k - 1]


@inlined
def _stand_on_end(k: int, n: int, desk: Matrix) -> None:
    for j in range(n):
        desk[Q, j] = desk[ENDS + n + k, j]


@inlined
def _best_end(settings: Vector, scores: Matrix) -> int:
    best = 0
    for k in range(1, int(settings[RESTARTS])):
        if scores[ERRORS, k] < scores[ERRORS, best]:
            best = k
    return best

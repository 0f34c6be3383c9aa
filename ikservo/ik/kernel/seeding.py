"""Score start configurations and set up an attempt.

The tool's pose at a seed, seen from the first joint's frame, turns about that frame's z as the
joint swings by δ. So what it shares with the wanted pose is ``a cos δ + b sin δ + c``, and the best
swing is known in closed form.
"""

from __future__ import annotations

import math

from ikservo.ik.kernel.jit import jit, jit_inline
from ikservo.ik.kernel.layout import (
    DIRECTION,
    END_COST,
    END_POINTS,
    KIND,
    NORMS,
    POS_ERR2,
    POSITION_FIRST,
    POSITION_ONLY,
    RESTARTS,
    ROT_ERR2,
    ROTATION_WEIGHT,
    SCORE_ROWS,
    SEED_COS,
    SEED_COS_Q1,
    SEED_COST,
    SEED_POSITION,
    SEED_Q1,
    SEED_RADIUS2,
    SEED_ROTATION,
    SEED_SIN,
    SEED_SIN_Q1,
    TOLERANCE_M,
    TRACK,
    WANTED_POSITION,
    WANTED_ROTATION,
    Q,
)
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.packed import COLUMN, POSITION

__all__ = [
    "MORE",
    "QUICK",
    "THOROUGH",
    "align_first_joint",
    "best_seed",
    "record_end",
    "reset_scores",
    "score_seeds",
    "score_view",
    "start_attempt",
]


@jit
def score_seeds(
    arm: Matrix, question: Vector, settings: Vector, seeds: Matrix, n: int, scores: Matrix
) -> None:
    """Write down the squared error that every seed promises, but for what all have in common."""
    kind, count = int(settings[KIND]), int(settings[RESTARTS]) - 1
    for k in range(count):
        scores[SEED_COS, k], scores[SEED_SIN, k] = 0.0, 0.0
        scores[SEED_COST, k] = seeds[n + SEED_RADIUS2, k]
    W = WANTED_POSITION
    v0 = question[W] - arm[1, POSITION]
    v1 = question[W + 1] - arm[1, POSITION + 1]
    v2 = question[W + 2] - arm[1, POSITION + 2]
    _add_seed_products(arm, v0, v1, v2, 1.0, seeds, n + SEED_POSITION, 1, count, scores)
    if kind != POSITION_ONLY:
        share = settings[ROTATION_WEIGHT] ** 2 * (1.0 if kind == DIRECTION else 0.5)
        for c in range(2 if kind == DIRECTION else 0, 3):
            W = WANTED_ROTATION + c
            v0, v1, v2 = question[W], question[W + 3], question[W + 6]
            _add_seed_products(
                arm, v0, v1, v2, share, seeds, n + SEED_ROTATION + c, 3, count, scores
            )
    for k in range(count):
        a, b, cosine = scores[SEED_COS, k], scores[SEED_SIN, k], seeds[n + SEED_COS_Q1, k]
        best = math.sqrt(a * a + b * b)
        end = a * cosine + abs(b) * seeds[n + SEED_SIN_Q1, k]
        scores[SEED_COST, k] -= 2.0 * (best if a >= cosine * best else end)


@jit_inline
def best_seed(settings: Vector, scores: Matrix) -> int:
    """Return the number of the best seed that was not tried yet, and cross it out."""
    best = 0
    for k in range(1, int(settings[RESTARTS]) - 1):
        if scores[SEED_COST, k] < scores[SEED_COST, best]:
            best = k
    scores[SEED_COST, best] = math.inf
    return best + 1


@jit
def align_first_joint(
    arm: Matrix, seeds: Matrix, seed: int, n: int, scores: Matrix, desk: Matrix
) -> None:
    """Put the first joint of Q, which stands on a seed, where that comes nearest."""
    k = seed - 1
    a, b, cosine = scores[SEED_COS, k], scores[SEED_SIN, k], seeds[n + SEED_COS_Q1, k]
    turn = math.atan2(b, a)
    if a < cosine * math.sqrt(a * a + b * b):
        turn = math.copysign(math.acos(cosine), b)
    desk[Q, int(arm[1, COLUMN])] = seeds[n + SEED_Q1, k] + turn


@jit
def _add_seed_products(
    arm: Matrix,
    v0: float,
    v1: float,
    v2: float,
    share: float,
    seeds: Matrix,
    row: int,
    step: int,
    count: int,
    scores: Matrix,
) -> None:
    """Add what a wanted vector (v0, v1, v2) shares with that of every seed, which begins in row."""
    x = share * (arm[1, 0] * v0 + arm[1, 3] * v1 + arm[1, 6] * v2)
    y = share * (arm[1, 1] * v0 + arm[1, 4] * v1 + arm[1, 7] * v2)
    z = share * (arm[1, 2] * v0 + arm[1, 5] * v1 + arm[1, 8] * v2)
    for k in range(count):
        scores[SEED_COS, k] += x * seeds[row, k] + y * seeds[row + step, k]
    for k in range(count):
        scores[SEED_SIN, k] += y * seeds[row, k] - x * seeds[row + step, k]
    for k in range(count):
        scores[SEED_COST, k] -= 2.0 * z * seeds[row + 2 * step, k]


QUICK, MORE, THOROUGH = 0, 1, 2
# How far a hop leaves the best end towards a seed.
_HOP_FRACTION = 0.35
# With priority ends that miss the position come after all that meet it.
_FAR = 1e6


@jit
def start_attempt(
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
            score_seeds(arm, question, settings, seeds, n, scores)
        seed = 0 if k == 0 else best_seed(settings, scores)
        _load_seed(start, seeds, seed, n, desk)
        if k > 0:
            align_first_joint(arm, seeds, seed, n, scores, desk)
        return seed
    if phase == THOROUGH:
        seed = _best_end_index(settings, scores)
        _load_end(seed, n, desk)
        scores[END_COST, seed] = math.inf
        return seed
    if settings[POSITION_FIRST] == 1.0 and settings[KIND] != POSITION_ONLY:
        return _restart_from_scores(settings, start, seeds, k, n, scores, desk)
    _start_between(settings, start, seeds, k, n, scores, desk)
    return k


@jit_inline
def score_view(n: int, restarts: int, desk: Matrix) -> Matrix:
    """Return the part of the desk (4, restarts) where seeds and ends are scored."""
    flat, first = desk.reshape(desk.size), (END_POINTS + n + restarts) * desk.shape[1]
    return flat[first : first + SCORE_ROWS * restarts].reshape((SCORE_ROWS, restarts))


@jit_inline
def reset_scores(restarts: int, scores: Matrix) -> None:
    """Forget where the attempts of the question before ended."""
    for k in range(restarts):
        scores[END_COST, k] = math.inf


@jit
def record_end(
    settings: Vector, placing: bool, seed: int, n: int, scores: Matrix, desk: Matrix
) -> None:
    """Note where a quick attempt ended, unless that seed has led somewhere better."""
    row = END_POINTS + n + seed
    error = desk[NORMS, POS_ERR2] + settings[ROTATION_WEIGHT] ** 2 * desk[NORMS, ROT_ERR2]
    if placing and desk[NORMS, POS_ERR2] > settings[TOLERANCE_M] ** 2:
        error += _FAR
    if error < scores[END_COST, seed]:
        for j in range(n):
            desk[row, j] = desk[Q, j]
        scores[END_COST, seed] = error


@jit
def _restart_from_scores(
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
        _load_seed(start, seeds, k - restarts, n, desk)
        return k - restarts
    _load_end(k, n, desk)
    scores[END_COST, k] = math.inf
    return k


@jit
def _start_between(
    settings: Vector,
    start: Vector,
    seeds: Matrix,
    k: int,
    n: int,
    scores: Matrix,
    desk: Matrix,
) -> None:
    """Stand between the best end and a seed."""
    _load_seed(start, seeds, k, n, desk)
    best = END_POINTS + n + _best_end_index(settings, scores)
    for j in range(n):
        desk[Q, j] = desk[best, j] + _HOP_FRACTION * (desk[Q, j] - desk[best, j])


@jit_inline
def _load_seed(start: Vector, seeds: Matrix, k: int, n: int, desk: Matrix) -> None:
    for j in range(n):
        desk[Q, j] = start[j] if k == 0 else seeds[j, k - 1]


@jit_inline
def _load_end(k: int, n: int, desk: Matrix) -> None:
    for j in range(n):
        desk[Q, j] = desk[END_POINTS + n + k, j]


@jit_inline
def _best_end_index(settings: Vector, scores: Matrix) -> int:
    best = 0
    for k in range(1, int(settings[RESTARTS])):
        if scores[END_COST, k] < scores[END_COST, best]:
            best = k
    return best

"""Score start configurations and set up an attempt.

Turning the first joint by δ rotates a seed's tool pose about that joint's z. The inner product with
the target pose is therefore ``a cos δ + b sin δ + c``, whose maximum has a closed form.
"""

from __future__ import annotations

import math

from ikservo.kernels.compiled import vectorised
from ikservo.kernels.layout import (
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


@vectorised
def score_seeds(
    arm: Matrix, problem: Vector, settings: Vector, seeds: Matrix, n: int, scores: Matrix
) -> None:
    """Fill SEED_COST with each seed's squared error at its best first joint, up to a constant."""
    kind, count = int(settings[KIND]), int(settings[RESTARTS]) - 1
    for k in range(count):
        scores[SEED_COS, k], scores[SEED_SIN, k] = 0.0, 0.0
        scores[SEED_COST, k] = seeds[n + SEED_RADIUS2, k]
    W = WANTED_POSITION
    v0 = problem[W] - arm[1, POSITION]
    v1 = problem[W + 1] - arm[1, POSITION + 1]
    v2 = problem[W + 2] - arm[1, POSITION + 2]
    _add_seed_products(arm, v0, v1, v2, 1.0, seeds, n + SEED_POSITION, 1, count, scores)
    if kind != POSITION_ONLY:
        weight = settings[ROTATION_WEIGHT]
        share = weight * weight * (1.0 if kind == DIRECTION else 0.5)
        for c in range(2 if kind == DIRECTION else 0, 3):
            W = WANTED_ROTATION + c
            v0, v1, v2 = problem[W], problem[W + 3], problem[W + 6]
            _add_seed_products(
                arm, v0, v1, v2, share, seeds, n + SEED_ROTATION + c, 3, count, scores
            )
    for k in range(count):
        a, b, cosine = scores[SEED_COS, k], scores[SEED_SIN, k], seeds[n + SEED_COS_Q1, k]
        best = math.sqrt(a * a + b * b)
        end = a * cosine + abs(b) * seeds[n + SEED_SIN_Q1, k]
        scores[SEED_COST, k] -= 2.0 * (best if a >= cosine * best else end)


def best_seed(settings: Vector, scores: Matrix) -> int:
    """Return the number of the best untried seed, and mark it as tried."""
    best = _least_index(scores, SEED_COST, int(settings[RESTARTS]) - 1)
    scores[SEED_COST, best] = math.inf
    return best + 1


def align_first_joint(
    arm: Matrix, seeds: Matrix, seed: int, n: int, scores: Matrix, work: Matrix
) -> None:
    """Turn the first joint of Q, which is a seed, to where the error is smallest."""
    k = seed - 1
    a, b, cosine = scores[SEED_COS, k], scores[SEED_SIN, k], seeds[n + SEED_COS_Q1, k]
    turn = math.atan2(b, a)
    if a < cosine * math.sqrt(a * a + b * b):
        turn = math.copysign(math.acos(cosine), b)
    work[Q, int(arm[1, COLUMN])] = seeds[n + SEED_Q1, k] + turn


@vectorised
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
    """Add the inner products of a target vector (v0, v1, v2) with the seeds' rows from ``row``."""
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
# Fraction of the distance from the best result to a seed at which a further attempt starts.
_HOP_FRACTION = 0.35
# This many attempts start at seeds; then every second one between the best result and a seed.
_ALONE, _HOPS = 12, 40
# With position first, results that miss the position rank after all results that reach it.
_FAR = 1e6


def start_attempt(
    arm: Matrix,
    problem: Vector,
    settings: Vector,
    start: Vector,
    seeds: Matrix,
    phase: int,
    k: int,
    n: int,
    scores: Matrix,
    work: Matrix,
) -> int:
    """Set Q to the start of attempt k; return the number of its seed."""
    if phase == QUICK or settings[TRACK] == 1.0:
        if k == 1:
            score_seeds(arm, problem, settings, seeds, n, scores)
        if k >= _ALONE and k % 2 == 0 and k < _ALONE + 2 * hops_between(settings):
            _start_between(settings, start, seeds, (k - _ALONE) // 2, n, scores, work)
            return (k - _ALONE) // 2
        seed = 0 if k == 0 else best_seed(settings, scores)
        _load_seed(start, seeds, seed, n, work)
        if k > 0:
            align_first_joint(arm, seeds, seed, n, scores, work)
        return seed
    if phase == THOROUGH:
        seed = _best_end_index(settings, scores)
        _load_end(seed, n, work)
        scores[END_COST, seed] = math.inf
        return seed
    if puts_position_first(settings):
        return _restart_from_scores(settings, start, seeds, k, n, scores, work)
    _start_between(settings, start, seeds, k, n, scores, work)
    return k


def hops_between(settings: Vector) -> int:
    """Count the quick attempts that start between the best result and a seed."""
    return (
        0 if puts_position_first(settings) else max(0, min(_HOPS, int(settings[RESTARTS]) - _ALONE))
    )


def puts_position_first(settings: Vector) -> bool:
    """Check whether the position is met first, and then the orientation as well as possible."""
    return settings[POSITION_FIRST] == 1.0 and settings[KIND] != POSITION_ONLY


def reset_scores(restarts: int, scores: Matrix) -> None:
    """Discard the results of the previous problem's attempts."""
    for k in range(restarts):
        scores[END_COST, k] = math.inf


def record_end(
    settings: Vector, position_only: bool, seed: int, n: int, scores: Matrix, work: Matrix
) -> None:
    """Store the result of a quick attempt, unless its seed has led to a better result before."""
    row, weight, tolerance_m = (
        END_POINTS + n + seed,
        settings[ROTATION_WEIGHT],
        settings[TOLERANCE_M],
    )
    error = work[NORMS, POS_ERR2] + weight * weight * work[NORMS, ROT_ERR2]
    if position_only and work[NORMS, POS_ERR2] > tolerance_m * tolerance_m:
        error += _FAR
    if error < scores[END_COST, seed]:
        for j in range(n):
            work[row, j] = work[Q, j]
        scores[END_COST, seed] = error


def _restart_from_scores(
    settings: Vector,
    start: Vector,
    seeds: Matrix,
    k: int,
    n: int,
    scores: Matrix,
    work: Matrix,
) -> int:
    """Start from every result, then from every seed; the results' weighted errors are dropped."""
    restarts = int(settings[RESTARTS])
    if k >= restarts:
        _load_seed(start, seeds, k - restarts, n, work)
        return k - restarts
    _load_end(k, n, work)
    scores[END_COST, k] = math.inf
    return k


def _start_between(
    settings: Vector,
    start: Vector,
    seeds: Matrix,
    k: int,
    n: int,
    scores: Matrix,
    work: Matrix,
) -> None:
    """Start between the best result and a seed."""
    _load_seed(start, seeds, k, n, work)
    best = END_POINTS + n + _best_end_index(settings, scores)
    for j in range(n):
        work[Q, j] = work[best, j] + _HOP_FRACTION * (work[Q, j] - work[best, j])


def _load_seed(start: Vector, seeds: Matrix, k: int, n: int, work: Matrix) -> None:
    for j in range(n):
        work[Q, j] = start[j] if k == 0 else seeds[j, k - 1]


def _load_end(k: int, n: int, work: Matrix) -> None:
    for j in range(n):
        work[Q, j] = work[END_POINTS + n + k, j]


def _best_end_index(settings: Vector, scores: Matrix) -> int:
    return _least_index(scores, END_COST, int(settings[RESTARTS]))


@vectorised
def _least_index(scores: Matrix, row: int, count: int) -> int:
    """Return the index of the smallest of a row's first entries; of equal entries, the first."""
    best, least = 0, scores[row, 0]
    for k in range(1, count):
        # kept in a register: reading it from the array would make each comparison wait for the last
        if scores[row, k] < least:
            best, least = k, scores[row, k]
    return best

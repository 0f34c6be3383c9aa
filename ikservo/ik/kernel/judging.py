"""Which seed promises most: where the tool comes nearest what is wanted as the first joint swings.

The tool's pose at a seed, seen from the first joint's frame, turns about that frame's z as the
joint swings by δ. So what it shares with the wanted pose is ``a cos δ + b sin δ + c``, and the best
swing is known in closed form.
"""

from __future__ import annotations

import math

from ikservo.ik.kernel.compiling import inlined, inner
from ikservo.ik.kernel.desk import ACROSS, ALONG, PROMISE, Q
from ikservo.ik.kernel.layout import (
    DIRECTION,
    KIND,
    POSITION_ONLY,
    RESTARTS,
    SEED_COSINE,
    SEED_FAR2,
    SEED_POSITION,
    SEED_ROTATION,
    SEED_SINE,
    SEED_SWING,
    TURN_WEIGHT,
    WANTED_POSITION,
    WANTED_ROTATION,
)
from ikservo.kinematics.packing import COLUMN, POSITION
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["judge", "most_promising", "swing"]


@inner
def judge(
    arm: Matrix, question: Vector, settings: Vector, seeds: Matrix, n: int, scores: Matrix
) -> None:
    """Write down the squared error that every seed promises, but for what all have in common."""
    kind, count = int(settings[KIND]), int(settings[RESTARTS]) - 1
    for k in range(count):
        scores[ALONG, k], scores[ACROSS, k] = 0.0, 0.0
        scores[PROMISE, k] = seeds[n + SEED_FAR2, k]
    W = WANTED_POSITION
    v0 = question[W] - arm[1, POSITION]
    v1 = question[W + 1] - arm[1, POSITION + 1]
    v2 = question[W + 2] - arm[1, POSITION + 2]
    _compare(arm, v0, v1, v2, 1.0, seeds, n + SEED_POSITION, 1, count, scores)
    if kind != POSITION_ONLY:
        share = settings[TURN_WEIGHT] ** 2 * (1.0 if kind == DIRECTION else 0.5)
        for c in range(2 if kind == DIRECTION else 0, 3):
            W = WANTED_ROTATION + c
            v0, v1, v2 = question[W], question[W + 3], question[W + 6]
            _compare(arm, v0, v1, v2, share, seeds, n + SEED_ROTATION + c, 3, count, scores)
    for k in range(count):
        a, b, cosine = scores[ALONG, k], scores[ACROSS, k], seeds[n + SEED_COSINE, k]
        best = math.sqrt(a * a + b * b)
        end = a * cosine + abs(b) * seeds[n + SEED_SINE, k]
        scores[PROMISE, k] -= 2.0 * (best if a >= cosine * best else end)


@inlined
def most_promising(settings: Vector, scores: Matrix) -> int:
    """Return the number of the best seed that was not tried yet, and cross it out."""
    best = 0
    for k in range(1, int(settings[RESTARTS]) - 1):
        if scores[PROMISE, k] < scores[PROMISE, best]:
            best = k
    scores[PROMISE, best] = math.inf
    return best + 1


@inner
def swing(arm: Matrix, seeds: Matrix, seed: int, n: int, scores: Matrix, desk: Matrix) -> None:
    """Put the first joint of Q, which stands on a seed, where that comes nearest."""
    k = seed - 1
    a, b, cosine = scores[ALONG, k], scores[ACROSS, k], seeds[n + SEED_COSINE, k]
    turn = math.atan2(b, a)
    if a < cosine * math.sqrt(a * a + b * b):
        turn = math.copysign(math.acos(cosine), b)
    desk[Q, int(arm[1, COLUMN])] = seeds[n + SEED_SWING, k] + turn


@inner
def _compare(
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
        scores[ALONG, k] += x * seeds[row, k] + y * seeds[row + step, k]
    for k in range(count):
        scores[ACROSS, k] += y * seeds[row, k] - x * seeds[row + step, k]
    for k in range(count):
        scores[PROMISE, k] -= 2.0 * z * seeds[row + 2 * step, k]

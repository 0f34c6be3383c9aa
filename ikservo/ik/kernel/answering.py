"""Which of two ends is the better answer, and how it is written down."""

from __future__ import annotations

import math

from ikservo.ik.kernel.compiling import inlined, inner
from ikservo.ik.kernel.desk import CHORD2, GAP2, GAUGE, HELD, NOTED, TOOL, Q
from ikservo.ik.kernel.layout import (
    GAP,
    KIND,
    NEAREST,
    POSITION_ONLY,
    PRIORITY,
    REACHED,
    SEED,
    TOLERANCE_M,
    TRACED,
    TURN,
    TURN_WEIGHT,
)
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["is_better", "way_from", "write"]

# Two answers whose errors differ by less are equally good: the one nearer the start is taken.
_SAME_M, _SAME_CHORD = 1e-7, 1e-6


@inlined
def way_from(start: Vector, n: int, desk: Matrix) -> float:
    """Return the squared length of the way from the start to Q."""
    way = 0.0
    for j in range(n):
        way += (desk[Q, j] - start[j]) ** 2
    return way


@inlined
def is_better(
    settings: Vector, reached: bool, way: float, best_way: float, desk: Matrix, best: Vector
) -> bool:
    """Compare the desk with the best answer: by success, by error, by the way from the start."""
    if reached or best[REACHED] == 1.0:
        return reached and (best[REACHED] == 0.0 or way < best_way)
    gap, chord = math.sqrt(desk[GAUGE, GAP2]), math.sqrt(desk[GAUGE, CHORD2])
    best_gap, best_chord = best[GAP], 2.0 * math.sin(0.5 * min(best[TURN], math.pi))
    if settings[KIND] == POSITION_ONLY or settings[PRIORITY] == 1.0:
        gap = max(gap, settings[TOLERANCE_M])
        best_gap = max(best_gap, settings[TOLERANCE_M])
    else:
        gap = math.hypot(gap, settings[TURN_WEIGHT] * chord)
        best_gap = math.hypot(best_gap, settings[TURN_WEIGHT] * best_chord)
        chord, best_chord = 0.0, 0.0
    if not abs(gap - best_gap) < _SAME_M:
        return gap < best_gap
    if abs(chord - best_chord) > _SAME_CHORD:
        return chord < best_chord
    return way < best_way


@inner
def write(reached: bool, seed: int, n: int, trace: Matrix, desk: Matrix, answer: Vector) -> None:
    """Write the desk into the answer, and move the trace to the half that is kept."""
    for r in range(int(desk[GAUGE, NOTED])):
        for j in range(n):
            trace[len(trace) // 2 + r, j] = trace[r, j]
    for j in range(n):
        answer[j] = desk[Q, j]
        answer[n + j] = desk[HELD, j]
    tail = answer[2 * n :]
    tail[REACHED] = 1.0 if reached else 0.0
    tail[GAP] = math.sqrt(desk[GAUGE, GAP2])
    tail[TURN] = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(desk[GAUGE, CHORD2])))
    for r in range(3):
        tail[NEAREST + r] = desk[TOOL, 9 + r]
    tail[SEED], tail[TRACED] = float(seed), desk[GAUGE, NOTED]

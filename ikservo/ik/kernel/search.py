"""The multi-start search, its entry points and the result record."""

from __future__ import annotations

import math

from ikservo.ik.kernel.descent import mark_active_limits, minimise, set_bounds, wrap_full_turns
from ikservo.ik.kernel.forward_kinematics import converged
from ikservo.ik.kernel.jit import jit, jit_entry, jit_inline
from ikservo.ik.kernel.layout import (
    ACTIVE,
    DIRECTION,
    EXTRA_RESTARTS,
    ITERATIONS,
    KIND,
    MAX_ANGLE_RAD,
    MAX_POSITION_M,
    NORMS,
    POS_ERR2,
    POSITION_ERROR,
    POSITION_FIRST,
    POSITION_ONLY,
    REACHED,
    REACHED_POINT,
    RESTARTS,
    ROT_ERR2,
    ROTATION_ERROR,
    ROTATION_WEIGHT,
    SEED_INDEX,
    TOLERANCE_M,
    TOOL_POSE,
    TRACE_LEN,
    TRACE_LENGTH_OUT,
    TRACK,
    WANTED_ROTATION,
    Q,
)
from ikservo.ik.kernel.nullspace import nullspace_descent
from ikservo.ik.kernel.seeding import (
    MORE,
    QUICK,
    THOROUGH,
    record_end,
    reset_scores,
    score_view,
    start_attempt,
)
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.packed import DOF

__all__ = [
    "all_within",
    "attempt",
    "distance_from",
    "is_better",
    "is_rotation",
    "solve_all",
    "write_result",
]


# Two answers whose errors differ by less are equally good: the one nearer the start is taken.
_SAME_M, _SAME_CHORD = 1e-7, 1e-6


@jit_inline
def distance_from(start: Vector, n: int, desk: Matrix) -> float:
    """Return the squared length of the way from the start to Q."""
    way = 0.0
    for j in range(n):
        way += (desk[Q, j] - start[j]) ** 2
    return way


@jit_inline
def is_better(
    settings: Vector, reached: bool, way: float, best_way: float, desk: Matrix, best: Vector
) -> bool:
    """Compare the desk with the best answer: by success, by error, by the way from the start."""
    if reached or best[REACHED] == 1.0:
        return reached and (best[REACHED] == 0.0 or way < best_way)
    gap, chord = math.sqrt(desk[NORMS, POS_ERR2]), math.sqrt(desk[NORMS, ROT_ERR2])
    best_gap, best_chord = (
        best[POSITION_ERROR],
        2.0 * math.sin(0.5 * min(best[ROTATION_ERROR], math.pi)),
    )
    if settings[KIND] == POSITION_ONLY or settings[POSITION_FIRST] == 1.0:
        gap = max(gap, settings[TOLERANCE_M])
        best_gap = max(best_gap, settings[TOLERANCE_M])
    else:
        gap = math.hypot(gap, settings[ROTATION_WEIGHT] * chord)
        best_gap = math.hypot(best_gap, settings[ROTATION_WEIGHT] * best_chord)
        chord, best_chord = 0.0, 0.0
    if not abs(gap - best_gap) < _SAME_M:
        return gap < best_gap
    if abs(chord - best_chord) > _SAME_CHORD:
        return chord < best_chord
    return way < best_way


@jit
def write_result(
    reached: bool, seed: int, n: int, trace: Matrix, desk: Matrix, answer: Vector
) -> None:
    """Write the desk into the answer, and move the trace to the half that is kept."""
    for r in range(int(desk[NORMS, TRACE_LEN])):
        for j in range(n):
            trace[len(trace) // 2 + r, j] = trace[r, j]
    for j in range(n):
        answer[j] = desk[Q, j]
        answer[n + j] = desk[ACTIVE, j]
    tail = answer[2 * n :]
    tail[REACHED] = 1.0 if reached else 0.0
    tail[POSITION_ERROR] = math.sqrt(desk[NORMS, POS_ERR2])
    tail[ROTATION_ERROR] = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(desk[NORMS, ROT_ERR2])))
    for r in range(3):
        tail[REACHED_POINT + r] = desk[TOOL_POSE, 9 + r]
    tail[SEED_INDEX], tail[TRACE_LENGTH_OUT] = float(seed), desk[NORMS, TRACE_LEN]


@jit
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
    n, weight, steps = int(arm[0, DOF]), settings[ROTATION_WEIGHT], 0
    free_turns = settings[TRACK] == 0.0 and not thorough
    first = thorough and settings[POSITION_FIRST] == 1.0 and settings[KIND] != POSITION_ONLY
    desk[NORMS, TRACE_LEN] = 0.0
    if first or placing:
        weight = 0.0
    set_bounds(arm, free_turns, desk)
    steps += minimise(arm, question, settings, weight, patience, trace, desk)
    if free_turns and wrap_full_turns(arm, start, desk):
        # once more, with the gap of a range that is not quite a full turn
        set_bounds(arm, False, desk)
        steps += minimise(arm, question, settings, weight, patience, trace, desk)
    if first and not converged(settings, 1.0, desk):
        steps += nullspace_descent(arm, question, settings, trace, desk)
    mark_active_limits(n, desk)
    return steps


_ROTATION_TOLERANCE = 1e-5


@jit_inline
def all_within(values: Vector, furthest: float) -> bool:
    """Return whether no value is further from 0 than that, nor NaN."""
    for value in values:  # noqa: SIM110  # numba compiles no generators
        if not abs(value) <= furthest:
            return False
    return True


@jit_inline
def is_rotation(question: Vector, kind: int) -> bool:
    """Return whether the wanted columns are unit vectors, right-handed and at right angles."""
    if kind == POSITION_ONLY:
        return True
    W = WANTED_ROTATION
    z0, z1, z2 = question[W + 2], question[W + 5], question[W + 8]
    off = abs(z0 * z0 + z1 * z1 + z2 * z2 - 1.0)
    if kind != DIRECTION:
        x0, x1, x2 = question[W], question[W + 3], question[W + 6]
        y0, y1, y2 = question[W + 1], question[W + 4], question[W + 7]
        off += abs(x1 * y2 - x2 * y1 - z0) + abs(x2 * y0 - x0 * y2 - z1)
        off += abs(x0 * y1 - x1 * y0 - z2) + abs(y1 * z2 - y2 * z1 - x0)
        off += abs(y2 * z0 - y0 * z2 - x1) + abs(y0 * z1 - y1 * z0 - x2)
    return off < _ROTATION_TOLERANCE


# How many slow steps in a row end a quick attempt: the start is given more than the others.
_MAX_STALLED_STEPS, _MAX_STALLED_AT_START, _UNLIMITED = 2, 4, 1 << 30
# A solution that was found this early is worth a look for a nearer one.
_EARLY = 4
# How many ends are refined; with priority all, for which turns out best shows only then.
_REFINED = 24


@jit_entry
def solve_all(
    arm: Matrix,
    questions: Matrix,
    settings: Vector,
    starts: Matrix,
    seeds: Matrix,
    desk: Matrix,
    trace: Matrix,
    answers: Matrix,
) -> int:
    """Answer every question from its own start; see ``layout`` for the arrays.

    Args:
        arm: The packed chain.
        questions: (m, QUESTION_SIZE).
        settings: (SETTINGS_SIZE,).
        starts: (m, dof).
        seeds: (dof + SEED_SIZE, RESTARTS - 1) further starting points.
        desk: ``work_shape(dof, RESTARTS)``, memory.
        trace: (t, dof), its second half for the iterates of the best attempt; may have no rows.
        answers: (m, 2 * dof + ANSWER_TAIL), filled.

    Returns:
        The first question that makes no sense, because a number is not finite or too large, or its
        rotation is none; then nothing is filled. -1 if there is none.
    """
    for i in range(len(questions)):
        if not (all_within(questions[i], MAX_POSITION_M) and all_within(starts[i], MAX_ANGLE_RAD)):
            return i
        if not is_rotation(questions[i], int(settings[KIND])):
            return i
    for i in range(len(questions)):
        _solve_one(arm, questions[i], settings, starts[i], seeds, trace, desk, answers[i])
    return -1


@jit
def _solve_one(
    arm: Matrix,
    question: Vector,
    settings: Vector,
    start: Vector,
    seeds: Matrix,
    trace: Matrix,
    desk: Matrix,
    answer: Vector,
) -> None:
    """Try the starting points in turn until one reaches; if none does, refine the best ends.

    Three phases: quick attempts from the start and the table; more of them, see below; thorough
    attempts from the best ends. More are, by weights, attempts from points between the best end so
    far and the table (a local minimum near the target is often next to the way). With priority
    they are walks to the wanted position alone, from where the first attempts ended and began.
    """
    n, restarts = int(arm[0, DOF]), int(settings[RESTARTS])
    first = settings[POSITION_FIRST] == 1.0 and settings[KIND] != POSITION_ONLY
    tail = answer[2 * n :]
    tail[REACHED], tail[POSITION_ERROR], tail[ROTATION_ERROR] = 0.0, math.inf, math.inf
    scores = score_view(n, restarts, desk)
    phase = THOROUGH if settings[TRACK] == 1.0 else QUICK
    steps, best_way, k, last = 0, math.inf, 0, restarts
    while k < last:
        thorough, placing = phase == THOROUGH, first and phase == MORE
        seed = start_attempt(arm, question, settings, start, seeds, phase, k, n, scores, desk)
        patience = (
            _UNLIMITED if thorough else _MAX_STALLED_AT_START if k == 0 else _MAX_STALLED_STEPS
        )
        steps += attempt(arm, question, settings, start, patience, thorough, placing, trace, desk)
        way, reached = distance_from(start, n, desk), converged(settings, 1.0, desk)
        if not (reached or thorough):
            if phase == QUICK and k == 0:
                reset_scores(restarts, scores)
            record_end(settings, placing, seed, n, scores, desk)
        counts = reached or thorough or placing
        if counts and is_better(settings, reached, way, best_way, desk, tail):
            if reached and tail[REACHED] == 0.0:
                last = min(last, k + 1 + (int(settings[EXTRA_RESTARTS]) if 0 < k < _EARLY else 0))
            best_way = way
            write_result(reached, seed, n, trace, desk, answer)
        k += 1
        if k == last and not thorough and tail[REACHED] == 0.0:
            phase, k = THOROUGH if phase == MORE or restarts == 1 else MORE, 0
            last = _attempt_count(phase, restarts, first)
    tail[ITERATIONS] = steps


@jit_inline
def _attempt_count(phase: int, restarts: int, first: bool) -> int:
    """Return how many attempts the second and the third phase make at most."""
    if first:
        return restarts if phase == THOROUGH else 2 * restarts
    return min(restarts, _REFINED) if phase == THOROUGH else restarts

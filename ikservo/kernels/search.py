"""The multi-start search, its entry point and the result record."""

from __future__ import annotations

import math

from ikservo.kernels.compiled import entry
from ikservo.kernels.descent import mark_active_limits, minimise, set_bounds, wrap_full_turns
from ikservo.kernels.forward_kinematics import converged
from ikservo.kernels.layout import (
    ACTIVE,
    DIRECTION,
    END_POINTS,
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
    PROBLEM_SIZE,
    REACHED,
    REACHED_POINT,
    RESTARTS,
    RESULT_TAIL,
    ROT_ERR2,
    ROTATION_ERROR,
    ROTATION_WEIGHT,
    SCORE_ROWS,
    SEED_INDEX,
    SEED_SIZE,
    SETTINGS_SIZE,
    TOLERANCE_M,
    TOOL_POSE,
    TRACE_LEN,
    TRACE_LENGTH_OUT,
    TRACK,
    WANTED_ROTATION,
    Q,
)
from ikservo.kernels.nullspace import nullspace_descent
from ikservo.kernels.seeding import (
    MORE,
    QUICK,
    THOROUGH,
    hops_between,
    puts_position_first,
    record_end,
    reset_scores,
    start_attempt,
)
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.packed import COLUMN, DOF, STEPS, WIDTH

# Results whose errors differ by less are equally good: the result nearer the start is taken.
_SAME_M, _SAME_CHORD = 1e-7, 1e-6


def distance_from(start: Vector, n: int, work: Matrix) -> float:
    """Compute the squared joint distance from the start to Q."""
    squared = 0.0
    for j in range(n):
        difference = work[Q, j] - start[j]
        squared += difference * difference
    return squared


def is_better(
    settings: Vector, reached: bool, distance: float, least: float, work: Matrix, best: Vector
) -> bool:
    """Compare Q with the best result by success, error, and distance from the start."""
    if reached or best[REACHED] == 1.0:
        return reached and (best[REACHED] == 0.0 or distance < least)
    error_m, chord = math.sqrt(work[NORMS, POS_ERR2]), math.sqrt(work[NORMS, ROT_ERR2])
    best_m, best_chord = (
        best[POSITION_ERROR],
        2.0 * math.sin(0.5 * min(best[ROTATION_ERROR], math.pi)),
    )
    if settings[KIND] == POSITION_ONLY or settings[POSITION_FIRST] == 1.0:
        error_m = max(error_m, settings[TOLERANCE_M])
        best_m = max(best_m, settings[TOLERANCE_M])
    else:
        error_m = _hypot(error_m, settings[ROTATION_WEIGHT] * chord)
        best_m = _hypot(best_m, settings[ROTATION_WEIGHT] * best_chord)
        chord, best_chord = 0.0, 0.0
    if not abs(error_m - best_m) < _SAME_M:
        return error_m < best_m
    if abs(chord - best_chord) > _SAME_CHORD:
        return chord < best_chord
    return distance < least


def _hypot(a: float, b: float) -> float:
    """Compute the length of (a, b); ``math.hypot`` does not round as the C library does."""
    return math.sqrt(a * a + b * b)


def write_result(
    reached: bool, seed: int, n: int, trace: Matrix, work: Matrix, result: Vector
) -> None:
    """Write the attempt into the result, and copy its trace to the half that is returned."""
    for r in range(int(work[NORMS, TRACE_LEN])):
        for j in range(n):
            trace[len(trace) // 2 + r, j] = trace[r, j]
    for j in range(n):
        result[j] = work[Q, j]
        result[n + j] = work[ACTIVE, j]
    tail = result[2 * n :]
    tail[REACHED] = 1.0 if reached else 0.0
    tail[POSITION_ERROR] = math.sqrt(work[NORMS, POS_ERR2])
    tail[ROTATION_ERROR] = 2.0 * math.asin(min(1.0, 0.5 * math.sqrt(work[NORMS, ROT_ERR2])))
    for r in range(3):
        tail[REACHED_POINT + r] = work[TOOL_POSE, 9 + r]
    tail[SEED_INDEX], tail[TRACE_LENGTH_OUT] = float(seed), work[NORMS, TRACE_LEN]


def attempt(
    arm: Matrix,
    problem: Vector,
    settings: Vector,
    start: Vector,
    max_stalled: int,
    thorough: bool,
    position_only: bool,
    free_turns: bool,
    trace: Matrix,
    work: Matrix,
) -> int:
    """Descend from Q and end inside the limits; return the steps.

    A thorough attempt with POSITION_FIRST solves the position and then reduces the orientation
    error in its null space.
    """
    n, weight, steps = int(arm[0, DOF]), settings[ROTATION_WEIGHT], 0
    first = thorough and puts_position_first(settings)
    work[NORMS, TRACE_LEN] = 0.0
    if first or position_only:
        weight = 0.0
    set_bounds(arm, free_turns, work)
    steps += minimise(arm, problem, settings, weight, max_stalled, trace, work)
    if free_turns and wrap_full_turns(arm, start, work):
        # again, now without the positions outside a range below a full turn
        set_bounds(arm, False, work)
        steps += minimise(arm, problem, settings, weight, max_stalled, trace, work)
    if first and not converged(settings, 1.0, work):
        steps += nullspace_descent(arm, problem, settings, trace, work)
    mark_active_limits(n, work)
    return steps


_ROTATION_TOLERANCE = 1e-5


def all_within(values: Vector, furthest: float) -> bool:
    """Check whether all values are at most ``furthest`` from 0, and none is NaN."""
    for i in range(len(values)):  # noqa: SIM110  # generators are not translated
        if not abs(values[i]) <= furthest:
            return False
    return True


def is_rotation(problem: Vector, kind: int) -> bool:
    """Check whether the target's columns are unit vectors, right-handed and at right angles."""
    if kind == POSITION_ONLY:
        return True
    W = WANTED_ROTATION
    z0, z1, z2 = problem[W + 2], problem[W + 5], problem[W + 8]
    off = abs(z0 * z0 + z1 * z1 + z2 * z2 - 1.0)
    if kind != DIRECTION:
        x0, x1, x2 = problem[W], problem[W + 3], problem[W + 6]
        y0, y1, y2 = problem[W + 1], problem[W + 4], problem[W + 7]
        off += abs(x1 * y2 - x2 * y1 - z0) + abs(x2 * y0 - x0 * y2 - z1)
        off += abs(x0 * y1 - x1 * y0 - z2) + abs(y1 * z2 - y2 * z1 - x0)
        off += abs(y2 * z0 - y0 * z2 - x1) + abs(y0 * z1 - y1 * z0 - x2)
    return off < _ROTATION_TOLERANCE


# Consecutive slow steps that end a quick attempt: more from the start than from other seeds.
_MAX_STALLED_STEPS, _MAX_STALLED_AT_START, _UNLIMITED = 2, 4, 1 << 30
# After a solution this early, further attempts look for a nearer one.
_EARLY = 4
# Number of results to refine; with position first all of them, because only then is the best known.
_REFINED = 24


def fits(
    arm: Matrix,
    problems: Matrix,
    settings: Vector,
    starts: Matrix,
    seeds: Matrix,
    work: Matrix,
    scores: Matrix,
    trace: Matrix,
    results: Matrix,
) -> bool:
    """Check whether arrays have the shapes that ``solve_all`` needs, and indices are in range."""
    if len(settings) != SETTINGS_SIZE or not is_packed_chain(arm):
        return False
    n, restarts, count = int(arm[0, DOF]), int(settings[RESTARTS]), len(problems)
    if restarts < 1 or len(starts) != count or len(results) != count:
        return False
    if restarts > 1 and (len(seeds) != n + SEED_SIZE or seeds.shape[1] < restarts - 1):
        return False
    return (
        problems.shape[1] == PROBLEM_SIZE
        and starts.shape[1] == n
        and results.shape[1] == 2 * n + RESULT_TAIL
        and len(work) >= END_POINTS + n + restarts
        and work.shape[1] >= max(n + 2, 12)
        and len(scores) == SCORE_ROWS
        and scores.shape[1] >= restarts
        and trace.shape[1] == n
    )


def is_packed_chain(arm: Matrix) -> bool:
    """Check whether an array has the shape of a packed chain, and its columns exist."""
    if len(arm) < 2 or arm.shape[1] != WIDTH:
        return False
    steps, n = int(arm[0, STEPS]), int(arm[0, DOF])
    if steps < 0 or n < 0 or len(arm) != 2 + steps + n:
        return False
    for i in range(1, steps + 1):
        column = arm[i, COLUMN]
        if not 0.0 <= column < n:
            return False
    return True


@entry(fits)
def solve_all(
    arm: Matrix,
    problems: Matrix,
    settings: Vector,
    starts: Matrix,
    seeds: Matrix,
    work: Matrix,
    scores: Matrix,
    trace: Matrix,
    results: Matrix,
) -> int:
    """Solve every problem from its own start; see ``layout`` for the arrays.

    Args:
        arm: The packed chain.
        problems: (m, PROBLEM_SIZE).
        settings: (SETTINGS_SIZE,).
        starts: (m, dof).
        seeds: (dof + SEED_SIZE, at least RESTARTS - 1) further starting points.
        work: Work array, at least ``work_shape(dof, RESTARTS)``.
        scores: Work array (SCORE_ROWS, at least RESTARTS).
        trace: (t, dof); the second half is for the iterates of the best attempt; may have no rows.
        results: (m, 2 * dof + RESULT_TAIL), filled.

    Returns:
        The first invalid problem: a number is not finite or too large, or its rotation is not
        valid; then nothing is filled. -1 if all are valid.
    """
    return solve_rows(arm, problems, settings, starts, seeds, work, scores, trace, results)


def solve_rows(
    arm: Matrix,
    problems: Matrix,
    settings: Vector,
    starts: Matrix,
    seeds: Matrix,
    work: Matrix,
    scores: Matrix,
    trace: Matrix,
    results: Matrix,
) -> int:
    """Solve every problem like ``solve_all``, for calls from other kernels."""
    for i in range(len(problems)):
        if not (all_within(problems[i], MAX_POSITION_M) and all_within(starts[i], MAX_ANGLE_RAD)):
            return i
        if not is_rotation(problems[i], int(settings[KIND])):
            return i
    for i in range(len(problems)):
        _solve_one(arm, problems[i], settings, starts[i], seeds, trace, work, scores, results[i])
    return -1


def _solve_one(
    arm: Matrix,
    problem: Vector,
    settings: Vector,
    start: Vector,
    seeds: Matrix,
    trace: Matrix,
    work: Matrix,
    scores: Matrix,
    result: Vector,
) -> None:
    """Try the starting points until an attempt reaches the target, or refine the best results.

    The best results are refined if no attempt reaches the target. There are three phases: QUICK
    attempts from the start and the seeds; MORE, see below; THOROUGH attempts from the best results.
    With weights, the attempts of MORE, and some QUICK attempts, start between the best result and
    the seeds, because a local minimum near the target often lies between them. With POSITION_FIRST,
    those of MORE seek only the target position, from results and starts of the first attempts.
    """
    n, restarts = int(arm[0, DOF]), int(settings[RESTARTS])
    first = puts_position_first(settings)
    tail = result[2 * n :]
    tail[REACHED], tail[POSITION_ERROR], tail[ROTATION_ERROR] = 0.0, math.inf, math.inf
    phase = THOROUGH if settings[TRACK] == 1.0 else QUICK
    steps, least, k, last = 0, math.inf, 0, restarts + hops_between(settings)
    while k < last:
        thorough, position_only = phase == THOROUGH, first and phase == MORE
        # A result at a limit may meet the position although a full turn leads to a better one.
        free_turns = not thorough and not (position_only and k < restarts)
        seed = start_attempt(arm, problem, settings, start, seeds, phase, k, n, scores, work)
        max_stalled = (
            _UNLIMITED if thorough else _MAX_STALLED_AT_START if k == 0 else _MAX_STALLED_STEPS
        )
        steps += attempt(
            arm,
            problem,
            settings,
            start,
            max_stalled,
            thorough,
            position_only,
            free_turns,
            trace,
            work,
        )
        distance, reached = distance_from(start, n, work), converged(settings, 1.0, work)
        if not (reached or thorough):
            if phase == QUICK and k == 0:
                reset_scores(restarts, scores)
            record_end(settings, position_only, seed, n, scores, work)
        counts = reached or thorough or position_only
        if counts and is_better(settings, reached, distance, least, work, tail):
            if reached and tail[REACHED] == 0.0:
                last = min(last, k + 1 + (int(settings[EXTRA_RESTARTS]) if 0 < k < _EARLY else 0))
            least = distance
            write_result(reached, seed, n, trace, work, result)
        k += 1
        if k == last and not thorough and tail[REACHED] == 0.0:
            phase, k = THOROUGH if phase == MORE or restarts == 1 else MORE, 0
            last = _attempt_count(phase, restarts, first)
    tail[ITERATIONS] = steps


def _attempt_count(phase: int, restarts: int, first: bool) -> int:
    """Compute the largest number of attempts in the second and the third phase."""
    if first:
        return restarts if phase == THOROUGH else 2 * restarts
    return min(restarts, _REFINED) if phase == THOROUGH else restarts

"""The search: attempts from the start and then from fixed points, the best of them answered."""

from __future__ import annotations

import math

from ikservo.ik.kernel.answering import is_better, way_from, write
from ikservo.ik.kernel.attempting import attempt
from ikservo.ik.kernel.checking import is_near, is_rotation
from ikservo.ik.kernel.compiling import entry, inlined, inner
from ikservo.ik.kernel.layout import (
    EXTRA_RESTARTS,
    FURTHEST_M,
    FURTHEST_RAD,
    GAP,
    ITERATIONS,
    KIND,
    POSITION_ONLY,
    PRIORITY,
    REACHED,
    RESTARTS,
    TRACK,
    TURN,
)
from ikservo.ik.kernel.looking import met
from ikservo.ik.kernel.setting_out import (
    MORE,
    QUICK,
    THOROUGH,
    clear_ends,
    keep_end,
    scores_on,
    set_out,
)
from ikservo.kinematics.packing import DOF
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["search_all"]

# How many slow steps in a row end a quick attempt: the start is given more than the others.
_PATIENCE, _PATIENCE_AT_START, _ENDLESS = 2, 4, 1 << 30
# A solution that was found this early is worth a look for a nearer one.
_EARLY = 4
# How many ends are refined; with priority all, for which turns out best shows only then.
_REFINED = 24


@entry
def search_all(
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
        desk: ``desk_shape(dof, RESTARTS)``, memory.
        trace: (t, dof), its second half for the iterates of the best attempt; may have no rows.
        answers: (m, 2 * dof + ANSWER_TAIL), filled.

    Returns:
        The first question that makes no sense, because a number is not finite or too large, or its
        rotation is none; then nothing is filled. -1 if there is none.
    """
    for i in range(len(questions)):
        if not (is_near(questions[i], FURTHEST_M) and is_near(starts[i], FURTHEST_RAD)):
            return i
        if not is_rotation(questions[i], int(settings[KIND])):
            return i
    for i in range(len(questions)):
        _search(arm, questions[i], settings, starts[i], seeds, trace, desk, answers[i])
    return -1


@inner
def _search(
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
    first = settings[PRIORITY] == 1.0 and settings[KIND] != POSITION_ONLY
    tail = answer[2 * n :]
    tail[REACHED], tail[GAP], tail[TURN] = 0.0, math.inf, math.inf
    scores = scores_on(n, restarts, desk)
    phase = THOROUGH if settings[TRACK] == 1.0 else QUICK
    steps, best_way, k, last = 0, math.inf, 0, restarts
    while k < last:
        thorough, placing = phase == THOROUGH, first and phase == MORE
        seed = set_out(arm, question, settings, start, seeds, phase, k, n, scores, desk)
        patience = _ENDLESS if thorough else _PATIENCE_AT_START if k == 0 else _PATIENCE
        steps += attempt(arm, question, settings, start, patience, thorough, placing, trace, desk)
        way, reached = way_from(start, n, desk), met(settings, 1.0, desk)
        if not (reached or thorough):
            if phase == QUICK and k == 0:
                clear_ends(restarts, scores)
            keep_end(settings, placing, seed, n, scores, desk)
        counts = reached or thorough or placing
        if counts and is_better(settings, reached, way, best_way, desk, tail):
            if reached and tail[REACHED] == 0.0:
                last = min(last, k + 1 + (int(settings[EXTRA_RESTARTS]) if 0 < k < _EARLY else 0))
            best_way = way
            write(reached, seed, n, trace, desk, answer)
        k += 1
        if k == last and not thorough and tail[REACHED] == 0.0:
            phase, k = THOROUGH if phase == MORE or restarts == 1 else MORE, 0
            last = _how_many(phase, restarts, first)
    tail[ITERATIONS] = steps


@inlined
def _how_many(phase: int, restarts: int, first: bool) -> int:
    """Return how many attempts the second and the third phase make at most."""
    if first:
        return restarts if phase == THOROUGH else 2 * restarts
    return min(restarts, _REFINED) if phase == THOROUGH else restarts

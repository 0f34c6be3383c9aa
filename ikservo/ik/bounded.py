"""The production solver: damped least squares inside the joint limits (lecture L9, L13).

Minimises ``|E(q)|²`` by Gauss-Newton and Newton steps with an active set, from the start and,
where that fails, from a fixed table of further starting points. The arithmetic is in ``kernel``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ikservo.errors import BadValueError
from ikservo.ik.kernel.layout import QUESTION_SIZE, TRACED
from ikservo.ik.options import Options
from ikservo.ik.preparing import Kind, Prepared, Worker, kernel, prepared, settings_of
from ikservo.ik.reading import result_of
from ikservo.ik.result import Result
from ikservo.ik.target import Target, near
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector

__all__ = ["bounded", "kind_of", "question_of", "ready_for"]

_TRACED = 2000


def bounded(
    chain: Chain, target: Target, q0: Vector, options: Options, first: Sequence[Vector] = ()
) -> Result:
    """Search from q0, then from the points of ``first``, then from a fixed table.

    The first solution ends the search, or, where q0 leads to none, the nearest to q0 of the first
    few. Without a solution the answer is the closest that any starting point led to.
    """
    restarts = 1 if options.track else options.restarts
    kind, ready = kind_of(target), ready_for(chain, target, restarts)
    seeds = ready.seeds
    if first and restarts > 1:
        given = ready.marked(chain, np.array(first), swinging=False)
        seeds = np.hstack([given, seeds])
    worker = Worker(chain.dof, restarts, traced=_TRACED if options.trace else 0)
    worker.question[0] = question_of(target)
    worker.start[0] = q0
    wrong = kernel()(
        ready.arm,
        worker.question,
        settings_of(kind, chain.dof, options),
        worker.start,
        seeds,
        worker.desk,
        worker.trace,
        worker.answer,
    )
    if wrong >= 0:
        raise BadValueError("The question", "none", "finite numbers and a rotation")
    for joint in ready.idle[kind]:
        stays = joint.stays_at(float(q0[joint.column]))
        worker.answer[0, joint.column] = worker.trace[:, joint.column] = stays
    result = result_of(chain, worker.answer[0], "bounded")
    return replace(result, trace=_trace(chain, q0, worker)) if options.trace else result


def _trace(chain: Chain, q0: Vector, worker: Worker) -> tuple[Vector, ...]:
    """Return the start, then the iterates of the attempt that led to the answer."""
    kept = worker.trace[_TRACED // 2 :][: int(worker.answer[0, 2 * chain.dof + TRACED])]
    steps = [chain.clip(row) for row in kept]
    start = chain.clip(q0)
    if steps and np.array_equal(steps[0], start):
        steps = steps[1:]
    return (start, *steps)


def kind_of(target: Target) -> Kind:
    """Return what of a pose a target asks for."""
    if target.direction is not None:
        return Kind.DIRECTION
    return Kind.POSITION if target.orientation is None else Kind.POSE


def ready_for(chain: Chain, target: Target, restarts: int = 1) -> Prepared:
    """Return the arm made ready for a target and so many starting points; it is kept."""
    axis = target.axis if kind_of(target) is Kind.DIRECTION else None
    return prepared(chain, target.frame, _offset(target), axis, restarts)


def _offset(target: Target) -> Vector | None:
    return None if target.offset_m is None else near(target.offset_m, "offset_m")


def question_of(target: Target) -> Vector:
    """Return a target as the kernels read it (QUESTION_SIZE,); of a direction only z counts."""
    question = np.zeros(QUESTION_SIZE)
    question[:3] = target.position
    if target.rotation is not None:
        question[3:] = target.rotation.ravel()
    elif target.wanted_axis is not None:
        question[5::3] = target.wanted_axis
    return question

"""The production solver's Python side: prepare, run the kernel, read its result.

Minimises ``|E(q)|²`` by Gauss-Newton and Newton steps with an active set, from the start and,
where that fails, from a fixed table of further starting points. The arithmetic is in ``kernel``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from ikservo.errors import BadValueError
from ikservo.ik.kernel.layout import (
    ITERATIONS,
    POSITION_ERROR,
    PROBLEM_SIZE,
    REACHED,
    REACHED_POINT,
    ROTATION_ERROR,
    TRACE_LENGTH_OUT,
)
from ikservo.ik.prepare import (
    PackedProblem,
    SolverBuffers,
    TargetKind,
    load_kernel,
    pack_problem,
    pack_settings,
)
from ikservo.ik.problem import Options, Target, check_position
from ikservo.ik.result import ActiveLimit, Result
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector

__all__ = [
    "bounded",
    "pack_target",
    "problem_for_target",
    "target_kind_of",
    "unpack_result",
]


def unpack_result(chain: Chain, answer: Vector, method: str) -> Result:
    """Return the result in one row of kernel output (2 dof + RESULT_TAIL,)."""
    n = chain.dof
    tail: list[float] = answer[2 * n :].tolist()
    reached = tail[REACHED] == 1.0
    return Result(
        q=answer[:n].copy(),
        reached=reached,
        position_error_m=tail[POSITION_ERROR],
        orientation_error_rad=tail[ROTATION_ERROR],
        binding=() if reached else _active_limits(chain, answer[n : 2 * n].tolist()),
        iterations=int(tail[ITERATIONS]),
        nearest_m=answer[2 * n + REACHED_POINT : 2 * n + REACHED_POINT + 3].copy(),
        method=method,
    )


def _active_limits(chain: Chain, held: list[float]) -> tuple[ActiveLimit, ...]:
    """Return the limits that were active at the end of the search."""
    return tuple(
        ActiveLimit(name, "lower" if side < 0.0 else "upper")
        for name, side in zip(chain.names, held, strict=True)
        if side
    )


_TRACED = 2000


def bounded(
    chain: Chain, target: Target, q0: Vector, options: Options, first: Sequence[Vector] = ()
) -> Result:
    """Search from q0, then from the points of ``first``, then from a fixed table.

    The first solution ends the search, or, if q0 leads to none, the nearest to q0 of the first
    few. Without a solution the result is the closest over all starting points.
    """
    restarts = 1 if options.track else options.restarts
    kind, ready = target_kind_of(target), problem_for_target(chain, target, restarts)
    seeds = ready.seeds
    if first and restarts > 1:
        given = ready.make_seeds(chain, np.array(first), swinging=False)
        seeds = np.hstack([given, seeds])
    worker = SolverBuffers(chain.dof, restarts, traced=_TRACED if options.trace else 0)
    worker.question[0] = pack_target(target)
    worker.start[0] = q0
    wrong = load_kernel()(
        ready.arm,
        worker.question,
        pack_settings(kind, chain.dof, options),
        worker.start,
        seeds,
        worker.work,
        worker.scores,
        worker.trace,
        worker.answer,
    )
    if wrong >= 0:
        raise BadValueError("The question", "none", "finite numbers and a rotation")
    for joint in ready.idle[kind]:
        stays = joint.resting_position(float(q0[joint.column]))
        worker.answer[0, joint.column] = worker.trace[:, joint.column] = stays
    result = unpack_result(chain, worker.answer[0], "bounded")
    return replace(result, trace=_read_trace(chain, q0, worker)) if options.trace else result


def _read_trace(chain: Chain, q0: Vector, worker: SolverBuffers) -> tuple[Vector, ...]:
    """Return the start, then the iterates of the attempt that led to the result."""
    kept = worker.trace[_TRACED // 2 :][: int(worker.answer[0, 2 * chain.dof + TRACE_LENGTH_OUT])]
    steps = [chain.clip(row) for row in kept]
    start = chain.clip(q0)
    if steps and np.array_equal(steps[0], start):
        steps = steps[1:]
    return (start, *steps)


def target_kind_of(target: Target) -> TargetKind:
    """Return the kind of a target."""
    if target.direction is not None:
        return TargetKind.DIRECTION
    return TargetKind.POSITION if target.orientation is None else TargetKind.POSE


def problem_for_target(chain: Chain, target: Target, restarts: int = 1) -> PackedProblem:
    """Return the arm packed for a target and so many starting points; it is cached."""
    axis = target.axis if target_kind_of(target) is TargetKind.DIRECTION else None
    return pack_problem(chain, target.frame, _offset_array(target), axis, restarts)


def _offset_array(target: Target) -> Vector | None:
    return None if target.offset_m is None else check_position(target.offset_m, "offset_m")


def pack_target(target: Target) -> Vector:
    """Return a target as the kernels read it (PROBLEM_SIZE,); a direction uses only z."""
    question = np.zeros(PROBLEM_SIZE)
    question[:3] = target.position
    if target.rotation is not None:
        question[3:] = target.rotation.ravel()
    elif target.target_axis is not None:
        question[5::3] = target.target_axis
    return question

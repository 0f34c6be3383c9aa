"""Python side of the production solver: prepare the search, run the kernel, read the result.

Minimises ``|E(q)|²`` by Gauss-Newton and Newton steps with an active set, from the start and, if
that fails, from a fixed table of further starting points. The arithmetic is in ``kernels``.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence
from typing import cast
from weakref import WeakKeyDictionary

import numpy as np

from ikservo.errors import BadValueError
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
from ikservo.kernels.compiled import bind
from ikservo.kernels.layout import (
    ITERATIONS,
    POSITION_ERROR,
    REACHED,
    REACHED_POINT,
    ROTATION_ERROR,
    TRACE_LENGTH_OUT,
)
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector


def unpack_result(
    chain: Chain, answer: Vector, method: str, trace: tuple[Vector, ...] = ()
) -> Result:
    """Return the result that is packed in one row of kernel output (2 dof + RESULT_TAIL,)."""
    n, row = chain.dof, answer.copy()
    numbers: list[float] = row.tolist()
    tail, nearest = numbers[2 * n :], 2 * n + REACHED_POINT
    reached = tail[REACHED] == 1.0
    binding: tuple[ActiveLimit, ...] = ()
    if not reached:
        binding = tuple(
            ActiveLimit(name, "lower" if side < 0.0 else "upper")
            for name, side in zip(chain.names, numbers[n : 2 * n], strict=True)
            if side
        )
    return Result(
        row[:n],
        reached,
        tail[POSITION_ERROR],
        tail[ROTATION_ERROR],
        binding,
        int(tail[ITERATIONS]),
        row[nearest : nearest + 3],
        method,
        trace,
    )


_TRACED = 2000


def bounded(
    chain: Chain, target: Target, q0: Vector, options: Options, first: Sequence[Vector] = ()
) -> Result:
    """Search from q0, then from the starting points in ``first``, then from those in a fixed table.

    If q0 leads to a solution, the search ends; otherwise the result is the solution nearest to q0
    among the first few, or the closest approach of all searches if there is no solution.
    """
    if first or options.trace:
        return Search(chain, target, options, first).solve(chain, target, q0)
    return _searches.find(chain, target, options).solve(chain, target, q0)


class Search:
    """Prepared search for one kind of target: kernel and arrays, for one thread.

    A search must not refer to its chain, because the chain is its key in the cache; otherwise
    neither would ever be freed.

    Args:
        chain: The arm.
        target: A target; any target with the same frame, offset and tool axis can be solved.
        options: Limits and priorities.
        first: Starting points (dof,) in addition to the table.
    """

    def __init__(
        self, chain: Chain, target: Target, options: Options, first: Sequence[Vector] = ()
    ) -> None:
        restarts = 1 if options.track else options.restarts
        kind, ready = target_kind_of(target), problem_for_target(chain, target, restarts)
        self.options, self._kind, self._idle, seeds = options, kind, ready.idle[kind], ready.seeds
        if first and restarts > 1:
            given = ready.make_seeds(chain, np.array(first), swinging=False)
            seeds = np.hstack([given, seeds])
        worker = SolverBuffers(chain.dof, restarts, traced=_TRACED if options.trace else 0)
        self._question, self._start = worker.question.reshape(4, 3), worker.start[0]
        self._answer, self._trace = worker.answer[0], worker.trace
        load_kernel()  # a kernel that is not compiled is registered by its module
        run = bind(
            "solve_all", ready.arm, worker.question, pack_settings(kind, chain.dof, options),
            worker.start, seeds, worker.work, worker.scores, worker.trace, worker.answer,
        )  # fmt: skip
        self._run_kernel = cast("Callable[[], int]", run)

    def solve(self, chain: Chain, target: Target, q0: Vector) -> Result:
        """Solve for a target, from ``q0`` (dof,)."""
        self._question[:] = target.packed
        self._start[:] = q0
        if self._run_kernel() >= 0:
            raise BadValueError("The problem", "invalid", "finite numbers and a rotation")
        for joint in self._idle:
            stays = joint.resting_position(self._start.item(joint.column))
            self._answer[joint.column] = self._trace[:, joint.column] = stays
        trace: tuple[Vector, ...] = ()
        if self.options.trace:  # the start, then the iterates of the attempt that led to the result
            count = int(self._answer[2 * chain.dof + TRACE_LENGTH_OUT])
            steps = [chain.clip(row) for row in self._trace[_TRACED // 2 :][:count]]
            start = chain.clip(q0)
            begins_at_start = bool(steps) and np.array_equal(steps[0], start)
            trace = (start, *(steps[1:] if begins_at_start else steps))
        return unpack_result(chain, self._answer, "bounded", trace)


_Key = tuple[bool, str | None, bytes, bytes, Options]
"""Cache key: whether the orientation is free; frame, point, axis for a direction; options."""


class _Searches(threading.local):
    """Cache of a thread's prepared searches: the most recent searches for each chain."""

    def __init__(self) -> None:
        self._prepared = WeakKeyDictionary[Chain, dict[_Key, Search]]()

    def find(self, chain: Chain, target: Target, options: Options) -> Search:
        """Return the search for targets of this kind; prepare it if necessary."""
        offset = _offset_array(target)
        point = b"" if offset is None else offset.tobytes()
        axis = b"" if target.direction is None else target.axis.tobytes()
        key = (target.orientation is None, target.frame, point, axis, options)
        kept = self._prepared.get(chain)
        if kept is None:
            kept = self._prepared[chain] = {}
        search = kept.get(key)
        if search is None:
            while len(kept) >= _MAX_SEARCHES:
                del kept[next(iter(kept))]
            search = kept[key] = Search(chain, target, options)
        return search


_MAX_SEARCHES = 16
_searches = _Searches()


def target_kind_of(target: Target) -> TargetKind:
    """Return the kind of a target."""
    if target.direction is not None:
        return TargetKind.DIRECTION
    return TargetKind.POSITION if target.orientation is None else TargetKind.POSE


def problem_for_target(chain: Chain, target: Target, restarts: int = 1) -> PackedProblem:
    """Return the arm packed for a target and a number of starting points; it is cached."""
    axis = target.axis if target_kind_of(target) is TargetKind.DIRECTION else None
    return pack_problem(chain, target.frame, _offset_array(target), axis, restarts)


def _offset_array(target: Target) -> Vector | None:
    return None if target.offset_m is None else check_position(target.offset_m, "offset_m")

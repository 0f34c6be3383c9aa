"""Common parts of all runners: read a problem from stdin, time each solve, write results to stdout.

A runner is started by the interpreter of its own virtual environment, so this file needs no more
than NumPy. One JSON object comes in (a problem), one goes out: ``{"cannot": reason}``, or
``{"version": ..., "rounds": {name: {"q": [...], "time_s": [...]}}, "batch": {...} or null}``.
"""

from __future__ import annotations

import gc
import json
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from importlib.metadata import version
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

__all__ = [
    "Array",
    "Batch",
    "CannotError",
    "Kind",
    "Problem",
    "Solve",
    "Tried",
    "restarting",
    "serve",
]

Array = NDArray[np.float64]
Kind = Literal["position", "direction", "pose"]
Solve = Callable[[Array, Array], "Array | None"]
"""From T_world_tip (4, 4) and start (dof,) to joints (dof,), or None if the solver gives up."""
Batch = Callable[[Array, Array], Array]
"""From poses (n, 4, 4) and starts (n, dof) to joints (n, dof), NaN if the solver gives up."""
Tried = tuple[Array, bool]
"""The end of one descent, and whether it is a solution."""

_TRIES = 20
_BATCH = 20_000


class CannotError(Exception):
    """The peer does not support the problem; the message says why."""


@dataclass(frozen=True)
class Problem:
    """One arm and one kind of target.

    Attributes:
        urdf: Path of the arm's URDF.
        base: Its root link.
        tip: The link that is the tool.
        path: Links and joints alternately from the base to the tip, fixed joints included.
        joints: The names of the moving joints on that path.
        lower: Their lower limits, rad.
        upper: Their upper limits, rad.
        axes: Their axes (dof, 3) in the base frame when all joints are zero.
        pivots: A point (dof, 3) on each of those axes, metres.
        tip_at_zero: T_world_tip (4, 4) when all joints are zero.
        kind: position, direction or pose.
        tool_axis: The axis (3,) of the tip for a direction.
        position_m: The position tolerance to request.
        angle_rad: The angular tolerance to request.
    """

    urdf: str
    base: str
    tip: str
    path: list[str]
    joints: list[str]
    lower: Array
    upper: Array
    axes: Array
    pivots: Array
    tip_at_zero: Array
    kind: Kind
    tool_axis: Array
    position_m: float
    angle_rad: float

    def only(self, *kinds: Kind) -> None:
        """Raise CannotError unless the peer supports the kind."""
        if self.kind not in kinds:
            raise CannotError(f"no {self.kind} targets")


def serve(
    distribution: str,
    prepare: Callable[[Problem], Solve],
    *,
    prepare_line: Callable[[Problem], Solve] | None = None,
    prepare_batch: Callable[[Problem], Batch] | None = None,
) -> None:
    """Execute the one request on stdin.

    Args:
        distribution: The package whose version is reported.
        prepare: Makes the solver; not timed.
        prepare_line: Makes the solver that follows a path, if the peer has a separate one.
        prepare_batch: Makes the solver of many targets at once, if the peer has one.
    """
    out = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)  # output of libraries must not get into the result
    request = json.load(sys.stdin)
    problem = _problem(request["problem"])
    try:
        solve = prepare(problem)
        follow = prepare_line(problem) if prepare_line else solve
        answer: dict[str, Any] = {
            "version": version(distribution),
            "rounds": {
                name: _run(follow if name == "line" else solve, targets, request["budget_s"])
                for name, targets in request["rounds"].items()
            },
            "batch": prepare_batch and _run_batch(prepare_batch(problem), request["rounds"]),
        }
    except CannotError as reason:
        answer = {"cannot": str(reason)}
    json.dump(answer, out)
    out.close()


def restarting(once: Callable[[Array, Array], Tried], problem: Problem) -> Solve:
    """Return a solver that tries again from random joints if a descent does not converge."""
    rng = np.random.default_rng(0)

    def solve(T: Array, q0: Array) -> Array | None:
        for _ in range(_TRIES):
            q, arrived = once(T, q0)
            if arrived:
                return q
            q0 = rng.uniform(problem.lower, problem.upper)
        return None

    return solve


def _problem(fields: dict[str, Any]) -> Problem:
    arrays = ("lower", "upper", "axes", "pivots", "tip_at_zero", "tool_axis")
    for name in arrays:
        fields[name] = np.array(fields[name], dtype=float)
    return Problem(**fields)


def _run(solve: Solve, targets: dict[str, Any], budget_s: float) -> dict[str, Any]:
    """Solve one target after another; a null start means the previous result."""
    poses, starts = np.array(targets["T"], dtype=float), targets["q0"]
    solve(poses[0], np.array(starts[0], dtype=float))  # compile, fill caches
    q: Array = np.zeros(0)
    found: list[list[float] | None] = []
    times_s: list[float] = []
    gc.collect()
    gc.disable()
    ends_s = time.perf_counter() + budget_s
    for T, start in zip(poses, starts, strict=True):
        q = q if start is None else np.array(start, dtype=float)
        started_s = time.perf_counter()
        answer = solve(T, q)
        now_s = time.perf_counter()
        times_s.append(now_s - started_s)
        found.append(None if answer is None else np.asarray(answer, dtype=float).tolist())
        q = q if answer is None else np.asarray(answer, dtype=float)
        if now_s > ends_s:
            break
    gc.enable()
    return {"q": found, "time_s": times_s}


def _run_batch(batch: Batch, rounds: dict[str, Any]) -> dict[str, Any]:
    """Solve the first round's targets repeatedly, with one call each time."""
    targets = next(iter(rounds.values()))
    poses, starts = np.array(targets["T"], dtype=float), np.array(targets["q0"], dtype=float)
    batch(poses, starts)
    times = -(-_BATCH // len(poses))
    many, from_where = np.tile(poses, (times, 1, 1)), np.tile(starts, (times, 1))
    started_s = time.perf_counter()
    q = batch(many, from_where)
    elapsed_s = time.perf_counter() - started_s
    return {"q": np.nan_to_num(q[: len(poses)], nan=1e9).tolist(), "rate_hz": len(many) / elapsed_s}

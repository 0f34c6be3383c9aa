"""Every method on one target: same start, same limits, same tolerance, and the time each takes."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from ikservo.cli.choosing import limit_sources, limit_words
from ikservo.cli.output import print_json, print_table
from ikservo.ik import METHODS, Result, Target, solve
from ikservo.ik.closed_form import structure
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector
from ikservo.model import Model

__all__ = ["Entry", "compare", "errors_along", "print_comparison", "print_traces"]

# The quickest of several runs, as long as these take less than this.
_RUNS, _ENOUGH_S = 5, 0.1


@dataclass(frozen=True, slots=True, eq=False)
class Entry:
    """What one method made of the target.

    Attributes:
        method: Its name.
        result: Its answer, with the trace.
        time_s: The quickest run without a trace, once everything is loaded and compiled.
    """

    method: str
    result: Result
    time_s: float


def compare(chain: Chain, target: Target, start: Vector) -> list[Entry]:
    """Run every method that suits the arm from the same start (dof,)."""
    names = [name for name in METHODS if name != "closed_form" or structure(chain, target.frame)]
    return [_entry(chain, target, start, name) for name in names]


def errors_along(chain: Chain, target: Target, result: Result) -> list[tuple[float, float]]:
    """Return position error [m] and orientation error [rad] at every iterate of a trace."""
    poses = [chain.forward(q, target.frame, target.offset_m) for q in result.trace or (result.q,)]
    return [
        (math.dist(target.position, T[:3, 3]), math.hypot(*target.turn_left(T[:3, :3])))
        for T in poses
    ]


def print_comparison(model: Model, entries: Sequence[Entry], target: Target, *, json: bool) -> None:
    """Print one row a method: did it reach, in how many iterations, how fast, how close."""
    if json:
        print_json(
            "compare",
            target_m=target.position,
            limit_from=limit_sources(model),
            methods=[_fields(model, entry) for entry in entries],
        )
        return
    columns = ["method", "reached", "iterations", "time", "error"]
    rows = [_row(entry) for entry in entries]
    if not target.only_position:
        columns.append("angle")
        for row, entry in zip(rows, entries, strict=True):
            row.append(f"{math.degrees(entry.result.orientation_error_rad):.3f}°")
    print_table(columns, rows)


def print_traces(chain: Chain, target: Target, results: Sequence[tuple[str, Result]]) -> None:
    """Print one JSON object a line for every iterate of every method."""
    for method, result in results:
        trace = result.trace or (result.q,)
        left = errors_along(chain, target, result)
        for i, (q, (gap_m, turn_rad)) in enumerate(zip(trace, left, strict=True)):
            print_json(
                "trace",
                method=method,
                iteration=i,
                q_rad=q,
                position_error_m=gap_m,
                orientation_error_rad=turn_rad,
            )


def _entry(chain: Chain, target: Target, start: Vector, method: str) -> Entry:
    result = solve(chain, target, start, method, trace=True)
    return Entry(method, result, _quickest_s(lambda: solve(chain, target, start, method)))


def _quickest_s(run: Callable[[], object]) -> float:
    taken_s: list[float] = []
    while len(taken_s) < _RUNS and sum(taken_s) < _ENOUGH_S:
        began_s = time.perf_counter()
        run()
        taken_s.append(time.perf_counter() - began_s)
    return min(taken_s)


def _row(entry: Entry) -> list[str]:
    result = entry.result
    return [
        _name(entry),
        "yes" if result.reached else "no",
        str(result.iterations),
        f"{entry.time_s * 1000:.3f} ms",
        f"{result.position_error_m * 1000:.4f} mm",
    ]


def _name(entry: Entry) -> str:
    """Return the method's name, and who answered where it handed the question on."""
    other = entry.result.method
    return entry.method if other == entry.method else f"{entry.method} (by {other})"


def _fields(model: Model, entry: Entry) -> dict[str, object]:
    result = entry.result
    return {
        "method": entry.method,
        "answered_by": result.method,
        "reached": result.reached,
        "iterations": result.iterations,
        "time_s": entry.time_s,
        "position_error_m": result.position_error_m,
        "orientation_error_rad": result.orientation_error_rad,
        "q_rad": result.q,
        "nearest_m": result.nearest_m,
        "binding": [limit_words(model, limit) for limit in result.binding],
    }

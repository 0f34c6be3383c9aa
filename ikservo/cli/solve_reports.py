"""Print the results of ``ikservo solve``: solutions, a comparison, or why there is none."""

from __future__ import annotations

import math
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ikservo.calibration import JointUnit, format_position
from ikservo.cli.entry_point import with_connection_options
from ikservo.cli.model_options import describe_limit, limit_sources
from ikservo.cli.posture_reports import joint_lines, result_fields, result_lines, torque_lines
from ikservo.cli.results import Field, Fields, print_records
from ikservo.cli.terminal import print_json, print_lines, print_status, print_table
from ikservo.errors import InputError, format_point
from ikservo.ik import METHODS, Result, Target, Tolerance, in_millimetres, solve
from ikservo.ik.closed_form import direction_intervals, solutions
from ikservo.ik.closed_form_structure import recognise_structure
from ikservo.ik.planar import DirectionInterval
from ikservo.ik.result import evaluate
from ikservo.kernels.compiled import is_compiled
from ikservo.kinematics import Chain, JointType, joint_torques
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model

_SAMPLES, _FLAT_M = 64, 1e-6


def explain_unreachable(chain: Chain, target: Target) -> str:
    """Explain in words why an arm cannot reach a point inside its joint limits."""
    flat = _base_plane(chain)
    if flat is not None:
        axis, at_m = flat
        if abs(float(target.position[axis]) - at_m) > _FLAT_M:
            return f"the arm moves only in the plane {'xyz'[axis]} = {at_m:z.3f} m"
    if JointType.PRISMATIC in chain.kinds or target.only_position:
        return "the links are too short"
    return "the links are too short, or the arm has too few joints for this orientation"


def ask_about_millimetres(chain: Chain, position_m: Sequence[float], command: str) -> None:
    """Suggest millimetres on stderr if the arm could reach the point in millimetres.

    ``command`` has ``{}`` for the point.
    """
    meant = in_millimetres(chain, position_m)
    if meant:
        hint = f"Did you mean millimetres? Try: ikservo {command.format(meant)}"
        print_status(with_connection_options(hint, sys.argv[1:]))


def _base_plane(chain: Chain) -> tuple[int, float] | None:
    """Return the axis (0, 1, 2) and offset [m] of the base plane in which the tip stays, if any."""
    chance = np.random.default_rng(1)
    low, high = np.maximum(chain.lower_rad, -np.pi), np.minimum(chain.upper_rad, np.pi)
    q = chance.uniform(low, high, (_SAMPLES, chain.dof))
    tips_m = np.array([chain.forward(each)[:3, 3] for each in q])
    spread_m = np.ptp(tips_m, axis=0)
    axis = int(np.argmin(spread_m))
    return (axis, float(tips_m[0, axis])) if spread_m[axis] < _FLAT_M else None


@dataclass(frozen=True, slots=True)
class AnalyticSolutions:
    """Closed-form solutions of a target.

    Attributes:
        structure: The recognised kinematic structure.
        results: One solution per branch, nearest to the start first.
        freedom: Possible directions of the last link, by branch, if the target leaves them free.
    """

    structure: str
    results: tuple[Result, ...]
    freedom: tuple[DirectionInterval, ...]


def all_solutions(model: Model, target: Target, start: Vector) -> AnalyticSolutions:
    """Return all closed-form solutions of an arm.

    Raises:
        InputError: The arm has no closed form.
    """
    chain = model.chain
    arm = recognise_structure(chain, target.frame)
    if arm is None:
        text = f"{model.title} has no closed-form solution, because of its arrangement of joints."
        raise InputError(text, "Omit --all for one numerical solution.")
    found = solutions(chain, target, start)
    free = direction_intervals(chain, target, start) if target.only_position else ()
    results = (
        evaluate(chain, target, q, Tolerance(), method="closed_form", iterations=0) for q in found
    )
    return AnalyticSolutions(str(arm), tuple(results), free)


def print_solutions(model: Model, found: AnalyticSolutions, *, json: bool) -> None:
    """Print one row per solution, and the freedom of the last link."""
    if json:
        print_json(
            "solutions",
            reached=any(result.reached for result in found.results),
            structure=found.structure,
            solutions=[
                {
                    "q_rad": result.q,
                    "position_error_m": result.position_error_m,
                    "orientation_error_rad": result.orientation_error_rad,
                }
                for result in found.results
            ],
            last_link_directions=list(found.freedom),
        )
        return
    units = joint_units(model.chain)
    rows = [
        [str(i), *map(format_position, result.q.tolist(), units),
         f"{result.position_error_m * 1000:.4f} mm"]
        for i, result in enumerate(found.results, start=1)
    ]  # fmt: skip
    print_table(["#", *model.chain.names, "error"], rows)
    print_lines([f"closed form of {found.structure}", *map(_format_freedom, found.freedom)])


def joint_units(chain: Chain) -> list[JointUnit]:
    """Return the unit of each joint's position."""
    return ["m" if kind is JointType.PRISMATIC else "rad" for kind in chain.kinds]


def _format_freedom(free: DirectionInterval) -> str:
    low, high = math.degrees(free.lower_rad), math.degrees(free.upper_rad)
    elbow = "elbow-up" if free.elbow else "elbow-down"  # elbow-down bends counterclockwise
    return (
        f"one-parameter family, {elbow}: last link {low:z.1f}° to {high:z.1f}° "
        f"(yaw {math.degrees(free.yaw_rad):z.1f}°)"
    )


# Methods that iterate from one start and may miss a target that others reach.
_ITERATIVE_METHODS = ("pseudo_inverse", "transpose", "ccd")


def print_result(
    model: Model, target: Target, result: Result, *, force_n: Vector | None = None, json: bool
) -> None:
    """Print joint positions, error, active limits and conditioning of a solution.

    With a force (3,) at the tip, the resulting joint torques are also printed.
    """
    torques = None if force_n is None else joint_torques(model.chain, result.q, force_n)
    if json:
        print_json("solve", **_result_fields(model, result, torques))
        return
    others = [f"solutions  {result.solutions}"] if result.reached else []
    print_lines([*_result_lines(model, target, result), *others, *result_lines(result)])
    if torques is not None:
        print_lines(torque_lines(model.chain, torques))


def _result_fields(model: Model, result: Result, torques: Vector | None) -> dict[str, object]:
    found = result.solutions
    fields: dict[str, object] = {} if torques is None else {"torques_nm": torques}
    return fields | {
        "reached": result.reached,
        "q_rad": result.q,
        "joints_rad": dict(zip(model.chain.names, result.q.tolist(), strict=True)),
        "limit_from": limit_sources(model),
        "position_error_m": result.position_error_m,
        "orientation_error_rad": result.orientation_error_rad,
        "method": result.method,
        "iterations": result.iterations,
        "nearest_m": result.nearest_m,
        "binding": [describe_limit(model, limit) for limit in result.binding],
        "solutions": {"kind": found.kind, "count": found.count, "freedom": found.freedom},
        **result_fields(result),
    }


def _result_lines(model: Model, target: Target, result: Result) -> list[str]:
    units = joint_units(model.chain)
    joints = zip(model.chain.names, zip(result.q.tolist(), units, strict=True), strict=True)
    lines = joint_lines(dict(joints))
    lines.append(f"{result.method}, {result.iterations} iterations")
    if result.reached:
        return [*lines, f"error  {_format_error_left(target, result)}"]
    limits = ", ".join(describe_limit(model, limit) for limit in result.binding)
    limits = limits or explain_unreachable(model.chain, target)
    nearest = format_point(result.nearest_m)
    is_iterative = result.method in _ITERATIVE_METHODS
    outcome = f"not reached by {result.method}" if is_iterative else "out of reach"
    lines.append(f"{outcome}: {limits}")
    return [*lines, f"nearest  {nearest}, {_format_error_left(target, result, 1)} away"]


def _format_error_left(target: Target, result: Result, digits: int = 4) -> str:
    error_text = f"{result.position_error_m * 1000:.{digits}f} mm"
    if target.only_position and result.orientation_error_rad == 0.0:
        return error_text
    return f"{error_text} and {math.degrees(result.orientation_error_rad):.{digits}f}°"


# The time of a method is the minimum of this many runs, or of fewer if they take this long in
# total.
_RUNS, _ENOUGH_S = 5, 0.1


@dataclass(frozen=True, slots=True, eq=False)
class MethodResult:
    """The result of one method with a trace, and its best time without a trace, after warm-up."""

    method: str
    result: Result
    time_s: float


def compare_methods(chain: Chain, target: Target, start: Vector) -> list[MethodResult]:
    """Run every method that supports the arm from the same start (dof,)."""
    entries: list[MethodResult] = []
    for method in METHODS:
        if method == "closed_form" and not recognise_structure(chain, target.frame):
            continue
        result = solve(chain, target, start, method, trace=True)
        taken_s: list[float] = []
        while len(taken_s) < _RUNS and sum(taken_s) < _ENOUGH_S:
            began_s = time.perf_counter()
            solve(chain, target, start, method)
            taken_s.append(time.perf_counter() - began_s)
        entries.append(MethodResult(method, result, min(taken_s)))
    return entries


def trace_errors(chain: Chain, target: Target, result: Result) -> list[tuple[float, float]]:
    """Return position error [m] and orientation error [rad] at every iterate of a trace."""
    poses = [chain.forward(q, target.frame, target.offset_m) for q in result.trace or (result.q,)]
    return [
        (math.dist(target.position, T[:3, 3]), math.hypot(*target.orientation_error(T[:3, :3])))
        for T in poses
    ]


def print_comparison(
    model: Model, entries: Sequence[MethodResult], target: Target, *, json: bool
) -> None:
    """Print one row per method: whether it reached the target, iterations, time and error."""
    fields = _comparison_fields(model, with_angle=not target.only_position)
    print_records("compare", "methods", entries, fields, json=json,
                  target_m=target.position, limit_from=limit_sources(model))  # fmt: skip
    if json:
        return
    compiled = "The method `bounded` is compiled; the other methods run as Python."
    print_status(
        compiled if is_compiled() else "All methods run as Python, because none is compiled."
    )


def print_traces(chain: Chain, target: Target, results: Sequence[tuple[str, Result]]) -> None:
    """Print one JSON object per line for every iterate of every method."""
    for method, result in results:
        trace = result.trace or (result.q,)
        left = trace_errors(chain, target, result)
        for i, (q, (gap_m, turn_rad)) in enumerate(zip(trace, left, strict=True)):
            print_json(
                "trace",
                method=method,
                iteration=i,
                q_rad=q,
                position_error_m=gap_m,
                orientation_error_rad=turn_rad,
            )


def _method_label(entry: MethodResult) -> str:
    """Return the method's name, with the name of the method to which it delegated, if any."""
    other = entry.result.method
    return entry.method if other == entry.method else f"{entry.method} (by {other})"


def _comparison_fields(model: Model, *, with_angle: bool) -> Fields[MethodResult]:
    return (
        Field("method", "method", _method_label),
        Field("answered_by", value=lambda entry: entry.result.method),
        Field("reached", "reached", value=lambda entry: entry.result.reached),
        Field("iterations", "iterations", value=lambda entry: entry.result.iterations),
        Field("compiled", value=lambda entry: entry.method == "bounded" and is_compiled()),
        Field("time_s", "time", lambda entry: f"{entry.time_s * 1000:.3f} ms"),
        Field(
            "position_error_m",
            "error",
            lambda entry: f"{entry.result.position_error_m * 1000:.4f} mm",
            lambda entry: entry.result.position_error_m,
        ),
        Field(
            "orientation_error_rad",
            "angle" if with_angle else "",
            lambda entry: f"{math.degrees(entry.result.orientation_error_rad):.3f}°",
            lambda entry: entry.result.orientation_error_rad,
        ),
        Field("q_rad", value=lambda entry: entry.result.q),
        Field("nearest_m", value=lambda entry: entry.result.nearest_m),
        Field(
            "binding",
            value=lambda entry: [describe_limit(model, limit) for limit in entry.result.binding],
        ),
    )

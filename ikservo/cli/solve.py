"""``ikservo solve``: joints for a point, without any hardware."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Annotated

import typer

from ikservo.cli.options import ArmOption, JsonOption, Length
from ikservo.cli.output import note, point, print_json, print_lines
from ikservo.cli.quantities import parse_axis
from ikservo.cli.solutions import all_solutions, joint_words, print_solutions
from ikservo.errors import ExitCode, InputError
from ikservo.ik import Result, Target, solve
from ikservo.kinematics.se3 import Vector
from ikservo.model import Model, arm_names, load_model

__all__ = ["command"]

_METHODS = "auto, bounded, closed_form, pseudo_inverse, transpose or ccd."

Tip = Annotated[str | None, typer.Option("--tip", help="The link that is the tool (for a .urdf).")]
Direction = Annotated[
    str | None, typer.Option("--direction", help="Where the tool axis shall point: X,Y,Z.")
]
ToolAxis = Annotated[
    str, typer.Option("--tool-axis", help="The tool axis in the tool's frame: x, y, z or X,Y,Z.")
]
Method = Annotated[str, typer.Option("--method", help=_METHODS)]
All = Annotated[bool, typer.Option("--all", help="Every solution in closed form.")]
Compare = Annotated[bool, typer.Option("--compare", help="Run every method on the target.")]
Trace = Annotated[bool, typer.Option("--trace", help="Every iterate, one JSON object a line.")]
Plot = Annotated[
    Path | None, typer.Option("--plot", help="Draw before, after and errors: FILE.svg or .png.")
]


def command(
    x: Length,
    y: Length,
    z: Length,
    *,
    arm: ArmOption = None,
    tip: Tip = None,
    direction: Direction = None,
    tool_axis: ToolAxis = "z",
    method: Method = "auto",
    everything: All = False,
    comparison: Compare = False,
    trace: Trace = False,
    plot: Plot = None,
    json: JsonOption = False,
) -> None:
    """Find joints inside the arm file's limits that bring the tip to X Y Z; nothing moves.

    ikservo solve 0.25 0.05 0.15 --arm so101

    ikservo solve 0.25 0.05 0.15 --arm so101 --compare --plot methods.svg
    """
    _check(method, plot, everything=everything, comparison=comparison, trace=trace)
    axis = None if direction is None else parse_axis(direction)
    target = Target((x, y, z), direction=axis, tool_axis=parse_axis(tool_axis))
    model = _model(arm, tip)
    start = model.chain_pose("home") if "home" in model.poses else model.chain.middle()
    if everything:
        answers = _print_all(model, target, start, json=json)
    elif comparison:
        answers = _print_comparison(model, target, start, trace=trace, json=json)
    else:
        keep = trace or plot is not None
        result = solve(model.chain, target, start, method, trace=keep)
        answers = [(result.method, result)]
        _print_one(model, target, result, trace=trace, json=json)
    if plot is not None:
        _draw(plot, model, target, start, answers)
    if not any(result.reached for _, result in answers):
        raise typer.Exit(ExitCode.UNREACHABLE)


def _check(
    method: str, plot: Path | None, *, everything: bool, comparison: bool, trace: bool
) -> None:
    """Refuse what contradicts itself or could not be drawn, before any work is done."""
    if everything and (comparison or trace):
        raise InputError("--all iterates nothing.", "Give it without --compare and --trace.")
    if method != "auto" and (everything or comparison):
        other = "--all" if everything else "--compare"
        raise InputError(f"{other} chooses the method itself.", "Leave --method away.")
    if plot is not None:
        from ikservo.cli.pictures import check_picture  # noqa: PLC0415  # few draw

        check_picture(plot)


def _model(arm: str | None, tip: str | None) -> Model:
    if not arm:
        known = ", ".join(arm_names())
        raise InputError("Which arm?", f"Give --arm or set IKSERVO_ARM. Known: {known}.")
    return load_model(arm, tip)


def _print_all(
    model: Model, target: Target, start: Vector, *, json: bool
) -> list[tuple[str, Result]]:
    found = all_solutions(model, target, start)
    if not found.results and not json:
        nearest = solve(model.chain, target, start)
        print_lines(_lines(nearest, target, model))
        return [("nearest", nearest)]
    print_solutions(model, found, json=json)
    return [(f"solution {i}", result) for i, result in enumerate(found.results, start=1)]


def _print_comparison(
    model: Model, target: Target, start: Vector, *, trace: bool, json: bool
) -> list[tuple[str, Result]]:
    from ikservo.cli.comparison import compare, print_comparison, print_traces  # noqa: PLC0415

    entries = compare(model.chain, target, start)
    answers = [(e.method, e.result) for e in entries if e.method == e.result.method]
    if trace:
        print_traces(model.chain, target, answers)
    else:
        print_comparison(entries, target, json=json)
    return answers


def _print_one(model: Model, target: Target, result: Result, *, trace: bool, json: bool) -> None:
    if trace:
        from ikservo.cli.comparison import print_traces  # noqa: PLC0415

        print_traces(model.chain, target, [(result.method, result)])
    elif json:
        print_json("solve", **_fields(result))
    else:
        print_lines(_lines(result, target, model))


def _draw(
    file: Path, model: Model, target: Target, start: Vector, answers: list[tuple[str, Result]]
) -> None:
    from ikservo.cli.solve_picture import draw  # noqa: PLC0415  # matplotlib takes a second

    draw(file, model, target, start, answers)
    note(f"Picture: {file}")


def _fields(result: Result) -> dict[str, object]:
    return {
        "reached": result.reached,
        "q_rad": result.q,
        "position_error_m": result.position_error_m,
        "orientation_error_rad": result.orientation_error_rad,
        "method": result.method,
        "iterations": result.iterations,
        "nearest_m": result.nearest_m,
        "binding": [str(limit) for limit in result.binding],
    }


def _lines(result: Result, target: Target, model: Model) -> list[str]:
    words = joint_words(model.chain, result.q)
    lines = [f"{name}  {word}" for name, word in zip(model.chain.names, words, strict=True)]
    lines.append(f"{result.method}, {result.iterations} iterations")
    if result.reached:
        return [*lines, f"error  {_left(result, target)}"]
    build = "the arm's length" if target.only_position else "the arm's build"
    held = ", ".join(str(limit) for limit in result.binding) or build
    nearest = point(result.nearest_m.tolist())
    lines.append(f"not reachable: held back by {held}")
    return [*lines, f"nearest  {nearest}, {_left(result, target, 1)} away"]


def _left(result: Result, target: Target, digits: int = 4) -> str:
    gap = f"{result.position_error_m * 1000:.{digits}f} mm"
    if target.only_position:
        return gap
    return f"{gap} and {math.degrees(result.orientation_error_rad):.{digits}f}°"

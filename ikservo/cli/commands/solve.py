"""``ikservo solve``: find joint positions for a point, without any hardware."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import numpy as np
import typer

from ikservo.cli.completion import complete_methods
from ikservo.cli.model_options import (
    LEANING,
    PostureOptions,
    calibrated_model_from_option,
    report_missing_freedom,
)
from ikservo.cli.options import ArmOption, JsonOption, Length, TipOption, ToolOptions
from ikservo.cli.quantities import parse_axis, parse_force_n
from ikservo.cli.solve_reports import (
    all_solutions,
    ask_about_millimetres,
    compare_methods,
    print_comparison,
    print_result,
    print_solutions,
    print_traces,
)
from ikservo.cli.terminal import print_status
from ikservo.errors import ExitCode, InputError
from ikservo.ik import Result, Target, solve
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model
from ikservo.model.tool import tool_frame

_METHODS = "auto, bounded, closed_form, pseudo_inverse, transpose or ccd."

ToolAxis = Annotated[
    str | None,
    typer.Option(
        "--tool-axis",
        help="Axis of the tip frame for --direction: x, y, z or X,Y,Z; default: the tool axis.",
    ),
]
Method = Annotated[str, typer.Option("--method", help=_METHODS, autocompletion=complete_methods)]
Nearest = Annotated[
    bool,
    typer.Option(
        "--nearest/--no-nearest",
        help="Take the solution nearest to the start, or the first one found.",
    ),
]
Force = Annotated[
    tuple[str, str, str] | None,
    typer.Option(
        "--force",
        metavar="FX FY FZ",
        help="Force at the tip in newtons, base frame; prints the joint torques.",
    ),
]
All = Annotated[bool, typer.Option("--all", help="List every closed-form solution.")]
Compare = Annotated[bool, typer.Option("--compare", help="Run every method on the target.")]
Trace = Annotated[
    bool, typer.Option("--trace", help="Print every iteration, one JSON object per line.")
]
Plot = Annotated[
    Path | None, typer.Option("--plot", help="Draw start, result and errors to FILE.svg or .png.")
]


def command(
    x: Length,
    y: Length,
    z: Length,
    *,
    arm: ArmOption = None,
    tip: TipOption = None,
    tool: ToolOptions,
    tool_axis: ToolAxis = None,
    preferred: PostureOptions,
    method: Method = "auto",
    nearest: Nearest = True,
    force: Force = None,
    everything: All = False,
    comparison: Compare = False,
    trace: Trace = False,
    plot: Plot = None,
    json: JsonOption = False,
) -> None:
    """Find joints inside this arm's limits that bring the tip to X Y Z; nothing moves.

    The limits come from the arm's calibration, or from its arm file if it has none.
    --direction is met as closely as possible; exit code 7: another option cannot be met.

    ikservo solve 0.25 0.05 0.15 --arm so101

    ikservo solve 0.25 0.05 0.15 --arm so101 --prefer home --weight wrist_roll=0

    ikservo solve 0.25 0.05 0.15 --arm so101 --force 0 0 -5

    ikservo solve 0.25 0.05 0.15 --arm so101 --compare --plot methods.svg
    """
    _check_options(method, plot, force, everything=everything, comparison=comparison, trace=trace)
    force_n = None if force is None else np.array([parse_force_n(part) for part in force])
    posed = tool.keep or {tool.pitch_rad, tool.roll_rad, tool.within_rad} != {None}
    if posed and (everything or comparison or trace or tool_axis or method != "auto"):
        raise InputError(
            "--pitch, --roll, --keep and --within cannot be combined with --all, --compare, "
            "--trace, --method or --tool-axis."
        )
    if (preferred.prefer or preferred.weight) and (
        posed or everything or comparison or method not in LEANING
    ):
        raise InputError(
            "--prefer and --weight need a method with a null space.",
            "Give them with --method auto or pseudo_inverse, and without --all, --compare, "
            "--pitch, --roll, --keep and --within.",
        )
    orientation = tool.orientation() if posed else None
    model = calibrated_model_from_option(arm, tip)
    posture = preferred.posture(model, model.chain)
    # A direction applies to the tool's axis, unless another axis is given.
    axis = tool_frame(model).approach_axis if tool_axis is None else parse_axis(tool_axis)
    direction = None if tool.direction is None else parse_axis(tool.direction)
    target, start = Target((x, y, z), direction=direction, tool_axis=axis), model.initial_joints()
    if everything:
        results = _print_all(model, target, start, json=json)
    elif comparison:
        results = _print_comparison(model, target, start, trace=trace, json=json)
    else:
        keep_trace = trace or plot is not None
        if orientation:
            from ikservo.planning.tool_orientation import solve_with_orientation  # noqa: PLC0415  # rarely used

            result = solve_with_orientation(
                model.chain, tool_frame(model), Target(target.position), orientation, start
            )
        else:
            result = solve(model.chain, target, start, method, trace=keep_trace, posture=posture,
                           nearest=nearest)  # fmt: skip
        results = [(result.method, result)]
        if posture is not None:
            report_missing_freedom(model.chain, result.q, directed=tool.direction is not None)
        if trace:
            print_traces(model.chain, target, results)
        else:
            print_result(model, target, result, force_n=force_n, json=json)
    if plot is not None:
        from ikservo.cli.plots import plot_solution  # noqa: PLC0415  # rarely used

        plot_solution(plot, model, target, start, results)
        print_status(f"Picture: {plot}")
    if not any(result.reached for _, result in results):
        ask_about_millimetres(model.chain, (x, y, z), "solve {}")
        raise typer.Exit(ExitCode.UNREACHABLE)


def _check_options(
    method: str,
    plot: Path | None,
    force: tuple[str, str, str] | None,
    *,
    everything: bool,
    comparison: bool,
    trace: bool,
) -> None:
    """Check for contradictory options and an unusable plot file, before any work is done."""
    if everything and (comparison or trace):
        raise InputError("--all has no iterations.", "Use it without --compare and --trace.")
    if method != "auto" and (everything or comparison):
        other = "--all" if everything else "--compare"
        raise InputError(f"{other} chooses the method.", "Omit --method.")
    if plot is not None:
        from ikservo.cli.plots import check_plot_file  # noqa: PLC0415  # rarely used, loads matplotlib

        check_plot_file(plot)
    if force is not None and (everything or comparison or trace):
        hint = "Give it without --all, --compare and --trace."
        raise InputError("--force shows the torques of one solution.", hint)


def _print_all(
    model: Model, target: Target, start: Vector, *, json: bool
) -> list[tuple[str, Result]]:
    found = all_solutions(model, target, start)
    if not found.results and not json:
        nearest = solve(model.chain, target, start)
        print_result(model, target, nearest, json=False)
        return [("nearest", nearest)]
    print_solutions(model, found, json=json)
    return [(f"solution {i}", result) for i, result in enumerate(found.results, start=1)]


def _print_comparison(
    model: Model, target: Target, start: Vector, *, trace: bool, json: bool
) -> list[tuple[str, Result]]:
    entries = compare_methods(model.chain, target, start)
    results = [(e.method, e.result) for e in entries if e.method == e.result.method]
    if trace:
        print_traces(model.chain, target, results)
    else:
        print_comparison(model, entries, target, json=json)
    return results

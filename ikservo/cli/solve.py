"""``ikservo solve``: joints for a point, without any hardware."""

from __future__ import annotations

from typing import Annotated

import typer

from ikservo.calibration import say
from ikservo.cli.options import ArmOption, JsonOption, Length
from ikservo.cli.output import point, print_json, print_lines
from ikservo.errors import ExitCode, InputError
from ikservo.ik import Result, Target, solve
from ikservo.kinematics import JointKind
from ikservo.model import Model, arm_names, load_model

__all__ = ["command"]

Method = Annotated[str, typer.Option("--method", help="auto or bounded.")]
Tip = Annotated[str | None, typer.Option("--tip", help="The link that is the tool (for a .urdf).")]


def command(
    x: Length,
    y: Length,
    z: Length,
    *,
    arm: ArmOption = None,
    tip: Tip = None,
    method: Method = "auto",
    json: JsonOption = False,
) -> None:
    """Find joints inside the arm file's limits that bring the tip to X Y Z; nothing moves.

    ikservo solve 0.25 0.05 0.15 --arm so101
    """
    if not arm:
        known = ", ".join(arm_names())
        raise InputError("Which arm?", f"Give --arm or set IKSERVO_ARM. Known: {known}.")
    model = load_model(arm, tip)
    start = model.chain_pose("home") if "home" in model.poses else None
    result = solve(model.chain, Target((x, y, z)), start, method)
    if json:
        print_json("solve", **_fields(result))
    else:
        print_lines(_lines(result, model))
    if not result.reached:
        raise typer.Exit(ExitCode.UNREACHABLE)


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


def _lines(result: Result, model: Model) -> list[str]:
    slides = [kind is JointKind.PRISMATIC for kind in model.chain.kinds]
    lines = [
        f"{name}  {say(q, 'm' if slide else 'rad')}"
        for name, slide, q in zip(model.chain.names, slides, result.q.tolist(), strict=True)
    ]
    lines.append(f"{result.method}, {result.iterations} iterations")
    if result.reached:
        return [*lines, f"error  {result.position_error_m * 1000:.4f} mm"]
    held = ", ".join(str(limit) for limit in result.binding) or "the arm's length"
    nearest = point(result.nearest_m.tolist())
    gap_mm = result.position_error_m * 1000
    lines.append(f"not reachable: held back by {held}")
    return [*lines, f"nearest  {nearest}, {gap_mm:.1f} mm away"]

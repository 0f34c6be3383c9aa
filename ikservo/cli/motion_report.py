"""Print the plan of a motion; execute one of the tip, and print its result."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import cast

import typer

from ikservo.arm import Arm, MotionPlan, MoveResult
from ikservo.arm.plan import NearLimit
from ikservo.calibration import JointUnit
from ikservo.cli.direction_check import check_directions_once
from ikservo.cli.options import MotionOptions
from ikservo.cli.posture_reports import joint_lines
from ikservo.cli.session import announce, motion_progress_bar
from ikservo.cli.terminal import print_json, print_lines
from ikservo.errors import ExitCode, format_point
from ikservo.model import Model

__all__ = ["make_tip_motion", "print_move_report", "print_plan"]


def print_plan(
    plan: MotionPlan,
    model: Model,
    goal: Mapping[str, float],
    change_rad: float = 0.0,
    *,
    json: bool,
) -> None:
    """Print a plan.

    Args:
        plan: The motion.
        model: The arm.
        goal: Goal positions, rad or m by joint name.
        change_rad: Rotation of the tool.
        json: Whether to print one JSON object.
    """
    if json:
        print_json("plan", **_plan_fields(plan, goal))
        return
    print_lines(joint_lines({name: (at, _joint_unit(model, name)) for name, at in goal.items()}))
    print_lines(_plan_lines(plan, change_rad), indent=9)


def make_tip_motion(machine: Arm, plan: MotionPlan, options: MotionOptions) -> MoveResult | None:
    """Announce and execute a plan of the tip; a dry run prints it instead, and returns None.

    It is made again where the directions of joints were tried first.
    """
    announce(plan, machine, options)
    if options.dry_run:
        goals = machine.joint_index.by_name(plan.goal)
        joints = {name: goals[name] for name in machine.chain.names}
        print_plan(plan, machine.model, joints, plan.orientation_change_rad, json=options.json)
        return None
    if check_directions_once(machine, options) and plan.motion is not None:
        plan = machine.plan(plan.motion)
    with motion_progress_bar() as on_progress:
        return cast("MoveResult", machine.execute(plan, on_progress))


def print_move_report(report: MoveResult | None, *, json: bool) -> None:
    """Print how a motion of the tip ended, if one was made; exit 1 if it is beside its goal."""
    if report is None:
        return
    if json:
        print_json(
            "move",
            target_m=report.target_m,
            commanded_tip_m=report.commanded_tip_m,
            measured_tip_m=report.measured_tip_m,
            error_m=report.error_m,
            duration_s=report.duration_s,
            reached=report.reached,
            binding=report.binding,
            orientation_error_rad=report.orientation_error_rad,
            orientation_requested=report.orientation_requested,
            orientation_change_rad=report.orientation_change_rad,
            path_error_rms_m=report.path_error_rms_m,
            path_error_max_m=report.path_error_max_m,
        )
    else:
        print_lines(
            [
                f"target     {format_point(report.target_m)}",
                f"commanded  {format_point(report.commanded_tip_m)}",
                f"measured   {format_point(report.measured_tip_m)}",
                f"error      {report.error_m * 1000:.2f} mm",
                *_path_error_lines(report),
                f"tool       {_format_orientation(report)}",
                f"duration   {report.duration_s:.2f} s",
                f"reached    {'yes' if report.reached else 'no'}",
                *(f"note       {text}" for text in report.binding),
            ]
        )
    if not report.reached:
        raise typer.Exit(ExitCode.FAILED)


def _describe_orientation_error(angle_rad: float, *, requested: bool) -> str:
    """Return the error of a requested orientation as text, or the change if none was requested."""
    angle = f"{math.degrees(angle_rad):.1f}°"
    if requested:
        return f"orientation error {angle}"
    return f"orientation changed by {angle} (none was requested)"


def _joint_unit(model: Model, name: str) -> JointUnit:
    return model.joint(name).joint_map.unit


def _plan_fields(plan: MotionPlan, goal: Mapping[str, float]) -> dict[str, object]:
    return {
        "target_m": plan.target_m,
        "q_rad": goal,
        "joints_rad": goal,
        "duration_s": plan.duration_s,
        "path_m": plan.path_m,
        "speed": plan.speed,
        "binding": _limiting_lines(plan),
        "near_limits": [
            {"joint": near.joint, "side": near.side, f"room_{near.unit}": near.margin}
            for near in plan.near_limits
        ],
        "orientation_error_rad": plan.orientation_error_rad,
        "orientation_requested": plan.orientation_requested,
        "tool_speed": plan.tool_speed,
    }


def _plan_lines(plan: MotionPlan, change_rad: float) -> list[str]:
    angle_rad = plan.orientation_error_rad if plan.orientation_requested else change_rad
    tool = _describe_orientation_error(angle_rad, requested=plan.orientation_requested)
    return [
        f"duration {plan.duration_s:.2f} s",
        f"path     {plan.path_m:.3f} m of the tip",
        f"speed    {plan.speed}",
        *([] if plan.tool_speed is None else [f"tip      {plan.tool_speed}"]),
        *(f"limit    {words}" for words in _limiting_lines(plan)),
        *(f"near     {_format_near_limit(near)}" for near in plan.near_limits),
        *([] if plan.target_m is None else [f"tool     {tool}"]),
    ]


def _limiting_lines(plan: MotionPlan) -> list[str]:
    """Return the joints that limit the duration, and the active limits of the solution."""
    held = [] if plan.solution is None else [str(limit) for limit in plan.solution.binding]
    return [*plan.time_limiting_joints, *held]


def _format_near_limit(near: NearLimit) -> str:
    room = f"{near.margin:.4f} m" if near.unit == "m" else f"{math.degrees(near.margin):.1f}°"
    return f"{near.joint} to {room} from its {near.side} limit"


def _path_error_lines(report: MoveResult) -> list[str]:
    rms_m, max_m = report.path_error_rms_m, report.path_error_max_m
    if rms_m is None or max_m is None:
        return []
    return [f"path error {rms_m * 1000:.2f} mm rms, {max_m * 1000:.2f} mm at most"]


def _format_orientation(report: MoveResult) -> str:
    requested = report.orientation_requested
    rad = report.orientation_error_rad if requested else report.orientation_change_rad
    return _describe_orientation_error(rad, requested=requested)

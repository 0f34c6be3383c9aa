"""Print the plan of a motion; execute a motion of the tip, and print its result."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import cast

import typer

from ikservo.arm import MotionPlan, MoveResult, OpenArm
from ikservo.calibration import JointUnit
from ikservo.cli.open_and_confirm import announce, motion_progress_bar
from ikservo.cli.options import MotionOptions
from ikservo.cli.posture_reports import joint_lines
from ikservo.cli.results import Field, Fields, print_fields
from ikservo.cli.terminal import print_lines
from ikservo.cli.wiggle_prompt import check_directions_once
from ikservo.errors import ExitCode, format_point
from ikservo.model import Model
from ikservo.planning.motion_plan import NearLimit


def print_plan(
    plan: MotionPlan,
    model: Model,
    goal: Mapping[str, float],
    change_rad: float = 0.0,
    *,
    json: bool,
) -> None:
    """Print a plan, its goal (rad or m by joint), and the rotation of the tool."""
    if not json:
        joints: dict[str, tuple[float, JointUnit]] = {
            name: (at, model.joint(name).joint_map.unit) for name, at in goal.items()
        }
        print_lines(joint_lines(joints))
    print_fields("plan", plan, _plan_fields(goal, change_rad), json=json, order=_PLAN_LINES,
                 width=9)  # fmt: skip


def _plan_fields(goal: Mapping[str, float], change_rad: float) -> Fields[MotionPlan]:
    def describe_tool(plan: MotionPlan) -> str | list[str]:
        if plan.target_m is None:
            return []
        return _describe_orientation(
            plan.orientation_error_rad, change_rad, requested=plan.orientation_requested
        )

    return (
        Field("target_m"),
        Field("q_rad", value=lambda _: goal),
        Field("joints_rad", value=lambda _: goal),
        Field("duration_s", "duration", lambda plan: f"{plan.duration_s:.2f} s"),
        Field("path_m", "path", lambda plan: f"{plan.path_m:.3f} m of the tip"),
        Field("speed", "speed"),
        Field("around", "around", lambda plan: [plan.around] if plan.around else []),
        Field("kept", "kept", lambda plan: list(plan.kept), lambda plan: list(plan.kept)),
        Field(
            "clearance_m",
            "nearest",
            _describe_clearance,
            lambda plan: plan.clearance_m if math.isfinite(plan.clearance_m) else None,
        ),
        Field("binding", "limit", _limiting_lines, _limiting_lines),
        Field(
            "near_limits",
            "near",
            lambda plan: [_format_near_limit(near) for near in plan.near_limits],
            lambda plan: [
                {"joint": near.joint, "side": near.side, f"room_{near.unit}": near.margin}
                for near in plan.near_limits
            ],
        ),
        Field("orientation_error_rad", "tool", describe_tool),
        Field("orientation_requested"),
        Field("tool_speed", "tip", lambda plan: [str(plan.tool_speed)] if plan.tool_speed else []),
    )


_PLAN_LINES = (
    "duration_s path_m speed around kept clearance_m tool_speed binding near_limits "
    "orientation_error_rad"
)


def _describe_clearance(plan: MotionPlan) -> str | list[str]:
    if not math.isfinite(plan.clearance_m):
        return []
    return f"{plan.clearance_m * 1000:.0f} mm to the arm itself, the table or a box"


def make_tip_motion(
    machine: OpenArm, plan: MotionPlan, options: MotionOptions
) -> MoveResult | None:
    """Announce and execute a plan of the tip; a dry run prints it and returns None.

    If the directions of joints were tested first, the plan is made again.
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


def _describe_path_error(report: MoveResult) -> list[str]:
    rms_m, max_m = report.path_error_rms_m, report.path_error_max_m
    if rms_m is None or max_m is None:
        return []
    return [f"{rms_m * 1000:.2f} mm rms, {max_m * 1000:.2f} mm at most"]


_RESULT: Fields[MoveResult] = (
    Field("target_m", "target", lambda report: format_point(report.target_m)),
    Field("commanded_tip_m", "commanded", lambda report: format_point(report.commanded_tip_m)),
    Field("measured_tip_m", "measured", lambda report: format_point(report.measured_tip_m)),
    Field("error_m", "error", lambda report: f"{report.error_m * 1000:.2f} mm"),
    Field("duration_s", "duration", lambda report: f"{report.duration_s:.2f} s"),
    Field("reached", "reached"),
    Field("binding", "note", lambda report: list(report.binding)),
    Field(
        "orientation_error_rad",
        "tool",
        lambda report: _describe_orientation(
            report.orientation_error_rad,
            report.orientation_change_rad,
            requested=report.orientation_requested,
        ),
    ),
    Field("orientation_requested"),
    Field("orientation_change_rad"),
    Field("path_error_rms_m", "path error", _describe_path_error),
    Field("path_error_max_m"),
)
_RESULT_LINES = (
    "target_m commanded_tip_m measured_tip_m error_m path_error_rms_m orientation_error_rad "
    "duration_s reached binding"
)


def print_move_report(report: MoveResult | None, *, json: bool) -> None:
    """Print the result of a tip motion, if there was one; exit 1 if the tip missed its target."""
    if report is None:
        return
    print_fields("move", report, _RESULT, json=json, order=_RESULT_LINES, width=11)
    if not report.reached:
        raise typer.Exit(ExitCode.FAILED)


def _describe_orientation(error_rad: float, change_rad: float, *, requested: bool) -> str:
    """Describe the error of a requested orientation, or the change if none was requested."""
    if requested:
        return f"orientation error {math.degrees(error_rad):.1f}°"
    return f"orientation changed by {math.degrees(change_rad):.1f}° (none was requested)"


def _limiting_lines(plan: MotionPlan) -> list[str]:
    """Return the joints that limit the duration, and the active limits of the solution."""
    held = [] if plan.solution is None else [str(limit) for limit in plan.solution.binding]
    return [*plan.time_limiting_joints, *held]


def _format_near_limit(near: NearLimit) -> str:
    room = f"{near.margin:.4f} m" if near.unit == "m" else f"{math.degrees(near.margin):.1f}°"
    return f"{near.joint} to {room} from its {near.side} limit"

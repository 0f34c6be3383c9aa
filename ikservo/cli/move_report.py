"""Print the plan and the result of a motion of the tip."""

from __future__ import annotations

from ikservo.arm import Arm, MotionPlan, MoveResult
from ikservo.cli.plan_report import describe_orientation_error, print_plan
from ikservo.cli.terminal import print_json, print_lines
from ikservo.errors import format_point

__all__ = ["print_move_report", "print_preview"]


def print_preview(plan: MotionPlan, machine: Arm, *, json: bool) -> None:
    """Print a plan of the tip: the joints at its end, duration, limits."""
    goals = machine.joint_index.by_name(plan.goal)
    joints = {name: goals[name] for name in machine.chain.names}
    print_plan(plan, machine.model, joints, plan.orientation_change_rad, json=json)


def print_move_report(report: MoveResult, *, json: bool) -> None:
    """Print how a motion of the tip ended."""
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
        return
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
            *(f"binds      {text}" for text in report.binding),
        ]
    )


def _path_error_lines(report: MoveResult) -> list[str]:
    rms_m, max_m = report.path_error_rms_m, report.path_error_max_m
    if rms_m is None or max_m is None:
        return []
    return [f"path error {rms_m * 1000:.2f} mm rms, {max_m * 1000:.2f} mm at most"]


def _format_orientation(report: MoveResult) -> str:
    requested = report.orientation_requested
    rad = report.orientation_error_rad if requested else report.orientation_change_rad
    return describe_orientation_error(rad, requested=requested)

"""``ikservo move``: move the tip to a point, optionally on a line or through other points."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, cast

import typer

from ikservo.arm import Arm, MotionPlan, MoveResult
from ikservo.arm.tool_orientation import ToolOrientation
from ikservo.cli.direction_check import check_directions_once
from ikservo.cli.model_options import (
    PreferOption,
    WeightOption,
    posture_from_options,
    report_missing_freedom,
)
from ikservo.cli.options import (
    ArmOption,
    CollisionOption,
    DirectionOption,
    DryRunOption,
    JsonOption,
    KeepOption,
    Length,
    NoWiggleOption,
    PitchOption,
    PortOption,
    RollOption,
    SpeedOption,
    TipOption,
    UncalibratedOption,
    YesOption,
    orientation_from_options,
    parse_length_m,
    parse_point_m,
)
from ikservo.cli.plan_report import describe_orientation_error, print_plan
from ikservo.cli.session import announce, open_from_options, progress_bar
from ikservo.cli.terminal import print_json, print_lines
from ikservo.errors import ExitCode, format_point

__all__ = ["command"]

Line = Annotated[bool, typer.Option("--line", help="On a straight line of the tip.")]
Via = Annotated[
    list[str] | None,
    typer.Option("--via", metavar="X,Y,Z", help="A point to pass without a stop; repeatable."),
]
Blend = Annotated[
    float,
    typer.Option(
        "--blend", parser=parse_length_m, metavar="LENGTH", help="How near a --via is passed."
    ),
]


def command(
    x: Length,
    y: Length,
    z: Length,
    *,
    arm: ArmOption = None,
    port: PortOption = None,
    speed: SpeedOption = "normal",
    line: Line = False,
    via: Via = None,
    blend: Blend = 0.02,
    pitch: PitchOption = None,
    roll: RollOption = None,
    direction: DirectionOption = None,
    keep: KeepOption = False,
    prefer: PreferOption = None,
    weight: WeightOption = None,
    collision: CollisionOption = True,
    dry_run: DryRunOption = False,
    uncalibrated: UncalibratedOption = False,
    no_wiggle: NoWiggleOption = False,
    tip: TipOption = None,
    yes: YesOption = False,
    json: JsonOption = False,
) -> None:
    """Move the tip to the point X Y Z in the arm's base frame.

    The tool keeps its orientation as far as the arm can, unless one is requested.

    ikservo move 0.25 0.05 0.15 --arm so101 --port sim

    ikservo move 250mm -50mm 0.15 --line --pitch -60

    ikservo move 0.25 0 0.15 --prefer wrist_roll=90 --prefer wrist_flex=0 --weight wrist_flex=0.5

    ikservo move 0.2 0.1 0.1 --via 0.2,0,0.2 --via 0.25,0.05,0.2 --blend 30mm
    """
    orientation = orientation_from_options(pitch, roll, direction, keep=keep)
    points = [*(parse_point_m(text) for text in via or ()), (x, y, z)]
    with open_from_options(
        arm, port, tip=tip, collisions=collision, uncalibrated=uncalibrated
    ) as machine:
        posture = posture_from_options(machine.model, machine.chain, prefer, weight)
        orientation = orientation if posture is None else replace(orientation, posture=posture)
        plan = _plan_motion(machine, points, orientation, speed, blend_m=blend, line=line)
        if posture is not None and plan.solution is not None:
            report_missing_freedom(machine.chain, plan.solution.q, directed=False)
        announce(plan, machine, yes=yes or dry_run)
        if dry_run:
            _print_preview(plan, machine, json=json)
            return
        if not no_wiggle and check_directions_once(machine, yes=yes):
            plan = _plan_motion(machine, points, orientation, speed, blend_m=blend, line=line)
        with progress_bar() as on_progress:
            report = cast("MoveResult", machine.execute(plan, on_progress))  # of a plan of the tip
    _print_move_report(report, json=json)
    if not report.reached:
        raise typer.Exit(ExitCode.FAILED)


def _plan_motion(
    machine: Arm,
    points: list[tuple[float, float, float]],
    orientation: ToolOrientation,
    speed: str,
    *,
    blend_m: float,
    line: bool,
) -> MotionPlan:
    if len(points) == 1 and not line:
        return machine.plan_to(points[0], speed=speed, stance=orientation)
    return machine.plan_through(points, blend_m=blend_m, line=line, speed=speed, stance=orientation)


def _print_preview(plan: MotionPlan, machine: Arm, *, json: bool) -> None:
    goals = machine.joint_index.by_name(plan.goal)
    joints = {name: goals[name] for name in machine.chain.names}
    print_plan(plan, machine.model, joints, plan.orientation_change_rad, json=json)


def _print_move_report(report: MoveResult, *, json: bool) -> None:
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

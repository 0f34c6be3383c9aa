"""``ikservo joints``: move single joints to positions; ``pose`` shares the code."""

from __future__ import annotations

from typing import Annotated

import typer

from ikservo.arm import JointMoveResult, OpenArm
from ikservo.cli.completion import complete_joints
from ikservo.cli.motion_report import print_plan
from ikservo.cli.open_and_confirm import (
    announce,
    motion_progress_bar,
    open_from_options,
    plan_motion,
)
from ikservo.cli.option_groups import Without
from ikservo.cli.options import ArmConnection, MotionOptions, PathOptions, SpeedOption, ThinkOption
from ikservo.cli.quantities import parse_angle_rad, parse_length_m
from ikservo.cli.results import Field, Fields, print_fields
from ikservo.cli.terminal import print_lines
from ikservo.cli.wiggle_prompt import check_directions_once
from ikservo.errors import BadValueError, ExitCode, InputError, format_point
from ikservo.model import Model
from ikservo.planning.motions import THINK_S, LookAt, MoveJoints

Goals = Annotated[
    list[str],
    typer.Argument(
        metavar="JOINT=POSITION…",
        help="In degrees, or with a unit: 0.2rad; 12mm for a sliding joint.",
        autocompletion=complete_joints,
    ),
]


def command(
    goals: Goals,
    *,
    connection: ArmConnection,
    speed: SpeedOption = "normal",
    think: ThinkOption = THINK_S,
    path: PathOptions,
    options: Annotated[MotionOptions, Without("tip")],
) -> None:
    """Move single joints to positions.

    ikservo joints elbow_flex=30 gripper=0.5rad --arm so101 --port sim
    """
    with open_from_options(connection, options, path.scene) as machine:
        positions = _parse_positions(goals, machine.model)
        motion = MoveJoints(positions, speed=speed, within=path.within(), think_s=think)
        report = make_joint_motion(machine, motion, options)
    print_report(report, machine.model, json=options.json)


def make_joint_motion(
    machine: OpenArm, motion: MoveJoints | LookAt, options: MotionOptions
) -> JointMoveResult | None:
    """Announce and execute a joint motion; a dry run prints its plan and returns None."""
    plan = plan_motion(machine, motion)
    announce(plan, machine, options)
    if options.dry_run:
        print_plan(plan, machine.model, plan.requested, json=options.json)
        return None
    check_directions_once(machine, options)
    with motion_progress_bar() as on_progress:
        return machine.execute(motion, on_progress)


_FIELDS: Fields[JointMoveResult] = (
    Field("goal_rad"),
    Field("measured_rad"),
    Field("measured_tip_m", "tip", lambda report: format_point(report.measured_tip_m)),
    Field("error_rad"),
    Field("duration_s", "duration", lambda report: f"{report.duration_s:.2f} s"),
    Field("reached", "reached"),
    Field("binding", "note", lambda report: list(report.binding)),
)


def print_report(report: JointMoveResult | None, model: Model, *, json: bool) -> None:
    """Print the result of a joint motion, if there was one; exit 1 if a joint missed its goal."""
    if report is None:
        return
    width = max(8, *map(len, report.goal_rad)) + 2
    if not json:
        print_lines(
            f"{name:{width}}{show(report.measured_rad[name])} (target {show(goal)})"
            for name, goal in report.goal_rad.items()
            for show in (model.joint(name).joint_map.format,)
        )
    print_fields("joints", report, _FIELDS, json=json, width=width)
    if not report.reached:
        raise typer.Exit(ExitCode.FAILED)


def _parse_positions(goals: list[str], model: Model) -> dict[str, float]:
    positions: dict[str, float] = {}
    for goal in goals:
        name, equals, text = goal.partition("=")
        if not equals:
            raise InputError(f"{goal!r} is not JOINT=POSITION (elbow_flex=30).")
        if name in positions:
            raise BadValueError(f"The target of {name}", "given twice", "one position per joint")
        slides = model.joint(name).joint_map.unit == "m"
        positions[name] = parse_length_m(text) if slides else parse_angle_rad(text)
    return positions

"""``ikservo move``: the tip goes to a point, on a line or through others if wanted."""

from __future__ import annotations

from dataclasses import replace
from typing import Annotated, cast

import typer

from ikservo.arm import Arm, MoveReport, Plan
from ikservo.arm.planning import Stance
from ikservo.cli.calibrating.wiggle import check_once
from ikservo.cli.options import (
    ArmOption,
    CollisionOption,
    DryRunOption,
    JsonOption,
    Length,
    NoWiggleOption,
    PortOption,
    SpeedOption,
    TipOption,
    UncalibratedOption,
    YesOption,
)
from ikservo.cli.output import point, print_json, print_lines
from ikservo.cli.posture import PreferOption, WeightOption, note_freedom, posture_of
from ikservo.cli.quantities import parse_length_m, parse_point_m
from ikservo.cli.reports.plan import orientation_words, print_plan
from ikservo.cli.session import announce, opened, watched
from ikservo.cli.stance import DirectionOption, KeepOption, PitchOption, RollOption, stance_of
from ikservo.errors import ExitCode

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
    stance = stance_of(pitch, roll, direction, keep=keep)
    points = [*(parse_point_m(text) for text in via or ()), (x, y, z)]
    with opened(arm, port, tip=tip, collisions=collision, uncalibrated=uncalibrated) as machine:
        posture = posture_of(machine.model, machine.chain, prefer, weight)
        stance = stance if posture is None else replace(stance, posture=posture)
        plan = _planned(machine, points, stance, speed, blend_m=blend, line=line)
        if posture is not None and plan.solution is not None:
            note_freedom(machine.chain, plan.solution.q, directed=False)
        announce(plan, machine, yes=yes or dry_run)
        if dry_run:
            _preview(plan, machine, json=json)
            return
        if not no_wiggle and check_once(machine, yes=yes):
            plan = _planned(machine, points, stance, speed, blend_m=blend, line=line)
        with watched() as draw:
            report = cast("MoveReport", machine.execute(plan, draw))  # of a plan of the tip
    _print(report, json=json)
    if not report.reached:
        raise typer.Exit(ExitCode.FAILED)


def _planned(
    machine: Arm,
    points: list[tuple[float, float, float]],
    stance: Stance,
    speed: str,
    *,
    blend_m: float,
    line: bool,
) -> Plan:
    if len(points) == 1 and not line:
        return machine.plan_to(points[0], speed=speed, stance=stance)
    return machine.plan_through(points, blend_m=blend_m, line=line, speed=speed, stance=stance)


def _preview(plan: Plan, machine: Arm, *, json: bool) -> None:
    workings = machine.workings
    goals = dict(zip(workings.servos.names, plan.goal.tolist(), strict=True))
    joints = {name: goals[name] for name in machine.chain.names}
    change_rad = workings.planner.turned(plan.start, plan.goal)
    print_plan(plan, machine.model, joints, change_rad, json=json)


def _print(report: MoveReport, *, json: bool) -> None:
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
        )
        return
    print_lines(
        [
            f"target     {point(report.target_m.tolist())}",
            f"commanded  {point(report.commanded_tip_m.tolist())}",
            f"measured   {point(report.measured_tip_m.tolist())}",
            f"error      {report.error_m * 1000:.2f} mm",
            f"tool       {_orientation(report)}",
            f"duration   {report.duration_s:.2f} s",
            f"reached    {'yes' if report.reached else 'no'}",
            *(f"binds      {words}" for words in report.binding),
        ]
    )


def _orientation(report: MoveReport) -> str:
    requested = report.orientation_requested
    rad = report.orientation_error_rad if requested else report.orientation_change_rad
    return orientation_words(rad, requested=requested)

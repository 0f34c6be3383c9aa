"""``ikservo move``: the tip goes to a point."""

from __future__ import annotations

from typing import Annotated

import typer

from ikservo.arm import MoveReport, Plan
from ikservo.cli.options import (
    ArmOption,
    CollisionOption,
    JsonOption,
    Length,
    PortOption,
    SpeedOption,
    UncalibratedOption,
    YesOption,
)
from ikservo.cli.output import point, print_json, print_lines
from ikservo.cli.session import announce, opened, watched
from ikservo.errors import ExitCode

__all__ = ["command"]

DryRun = Annotated[bool, typer.Option("--dry-run", help="Plan and print, but do not move.")]


def command(
    x: Length,
    y: Length,
    z: Length,
    *,
    arm: ArmOption = None,
    port: PortOption = None,
    speed: SpeedOption = "normal",
    collision: CollisionOption = True,
    dry_run: DryRun = False,
    uncalibrated: UncalibratedOption = False,
    yes: YesOption = False,
    json: JsonOption = False,
) -> None:
    """Move the tip to the point X Y Z in the arm's base frame.

    ikservo move 0.25 0.05 0.15 --arm so101 --port sim

    ikservo move 250mm -50mm 0.15 --speed slow
    """
    with opened(arm, port, collisions=collision, uncalibrated=uncalibrated) as machine:
        plan = machine.plan_to((x, y, z), speed=speed)
        announce(plan, machine, yes=yes or dry_run)
        if dry_run:
            _print_plan(plan, machine.chain.names, json=json)
            return
        with watched() as draw:
            report = machine.carry_out(plan, draw)
    _print(report, json=json)
    if not report.reached:
        raise typer.Exit(ExitCode.FAILED)


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
        )
        return
    print_lines(
        [
            f"target     {point(report.target_m.tolist())}",
            f"commanded  {point(report.commanded_tip_m.tolist())}",
            f"measured   {point(report.measured_tip_m.tolist())}",
            f"error      {report.error_m * 1000:.2f} mm",
            f"duration   {report.duration_s:.2f} s",
            f"reached    {'yes' if report.reached else 'no'}",
        ]
    )


def _print_plan(plan: Plan, names: tuple[str, ...], *, json: bool) -> None:
    assert plan.solution is not None  # noqa: S101  # plan_to always solves
    q = dict(zip(names, plan.solution.q.tolist(), strict=True))
    if json:
        print_json("plan", target_m=plan.target_m, q_rad=q, duration_s=plan.duration_s)
        return
    print_lines([f"{name} {value:.4f} rad" for name, value in q.items()])
    print_lines([f"duration {plan.duration_s:.2f} s"])

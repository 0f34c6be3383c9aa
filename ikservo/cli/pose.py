"""``ikservo pose``: move all joints to a named pose."""

from __future__ import annotations

from typing import Annotated

import typer

from ikservo.arm import Arm
from ikservo.cli.joints import move_joints, preview, print_report
from ikservo.cli.options import (
    ArmOption,
    CollisionOption,
    DryRunOption,
    JsonOption,
    NoWiggleOption,
    PortOption,
    SpeedOption,
    UncalibratedOption,
    YesOption,
    complete_poses,
)
from ikservo.cli.session import open_from_options
from ikservo.cli.terminal import print_json, print_lines, print_status

__all__ = ["command"]

Name = Annotated[
    str | None,
    typer.Argument(
        metavar="NAME", help="rest, home, zero, or one you taught.", autocompletion=complete_poses
    ),
]


def command(
    name: Name = None,
    *,
    arm: ArmOption = None,
    port: PortOption = None,
    speed: SpeedOption = "normal",
    collision: CollisionOption = True,
    dry_run: DryRunOption = False,
    uncalibrated: UncalibratedOption = False,
    no_wiggle: NoWiggleOption = False,
    yes: YesOption = False,
    json: JsonOption = False,
) -> None:
    """Move to a pose of the arm file or to one you taught; without a name, list them.

    ikservo pose home --arm so101 --port sim
    """
    with open_from_options(arm, port, collisions=collision, uncalibrated=uncalibrated) as machine:
        if name is None:
            _print_poses(machine, json=json)
            return
        inside = machine.pose_within_limits(name)
        positions = inside.positions
        for words in inside.changed:
            print_status(f"{words}.")
        if dry_run:
            preview(machine, positions, speed, json=json)
            return
        report = move_joints(machine, positions, speed, yes=yes, wiggle=not no_wiggle)
    print_report(report, machine.model, json=json)


def _print_poses(machine: Arm, *, json: bool) -> None:
    if json:
        print_json(
            "poses", poses=machine.poses.all_poses(), taught=sorted(machine.poses.user_poses())
        )
    else:
        print_lines(machine.poses.all_poses())

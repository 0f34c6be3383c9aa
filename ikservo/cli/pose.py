"""``ikservo pose``: all joints go to a named pose."""

from __future__ import annotations

from typing import Annotated

import typer

from ikservo.cli.joints import move_joints, print_report
from ikservo.cli.options import (
    ArmOption,
    CollisionOption,
    JsonOption,
    PortOption,
    SpeedOption,
    UncalibratedOption,
    YesOption,
)
from ikservo.cli.session import opened

__all__ = ["command"]

Name = Annotated[str, typer.Argument(metavar="NAME", help="rest, home, zero, or another.")]


def command(
    name: Name,
    *,
    arm: ArmOption = None,
    port: PortOption = None,
    speed: SpeedOption = "normal",
    collision: CollisionOption = True,
    uncalibrated: UncalibratedOption = False,
    yes: YesOption = False,
    json: JsonOption = False,
) -> None:
    """Move to a pose that the arm file names.

    ikservo pose home --arm so101 --port sim
    """
    with opened(arm, port, collisions=collision, uncalibrated=uncalibrated) as machine:
        report = move_joints(machine, machine.model.pose(name), speed, yes=yes)
    print_report(report, machine.model, json=json)

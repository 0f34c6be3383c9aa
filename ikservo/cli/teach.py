"""``ikservo teach``: a pose that a person's hand gives the arm gets a name."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from ikservo.arm import Arm
from ikservo.cli.options import ArmOption, JsonOption, PortOption, UncalibratedOption, YesOption
from ikservo.cli.output import note, print_json, print_lines
from ikservo.cli.session import announce, opened
from ikservo.errors import InputError

__all__ = ["command"]

Name = Annotated[str, typer.Argument(metavar="NAME", help="1 to 64 of A-Z a-z 0-9 _ -")]
Now = Annotated[
    bool, typer.Option("--now", help="Keep the pose it is in; do not relax, do not ask.")
]
Hold = Annotated[bool, typer.Option("--hold", help="Hold the arm there afterwards.")]


def command(
    name: Name,
    *,
    arm: ArmOption = None,
    port: PortOption = None,
    now: Now = False,
    hold: Hold = False,
    uncalibrated: UncalibratedOption = False,
    yes: YesOption = False,
    json: JsonOption = False,
) -> None:
    """Relax the arm, let you bring it into a pose, and keep that under a name.

    ikservo teach cup --arm so101

    ikservo pose cup --arm so101
    """
    if not now and not sys.stdin.isatty():
        raise InputError("Nobody is here to press Enter.", "Give --now to keep the pose it is in.")
    with opened(arm, port, uncalibrated=uncalibrated) as machine:
        machine.poses.check_name(name)
        if not now:
            _announce_relaxing(machine, yes=yes)
        positions = machine.teach(name, None if now else _until_enter, hold=hold)
        path = machine.poses.path
    if json:
        print_json("teach", name=name, joints_rad=positions, path=str(path))
        return
    say = {joint: machine.model.joint(joint).joint_map.say for joint in positions}
    print_lines([f"{joint}  {say[joint](value)}" for joint, value in positions.items()])
    note(f"Kept as {name} in {path}.")


def _announce_relaxing(machine: Arm, *, yes: bool) -> None:
    if any(state.torque for state in machine.where().joints):
        rest = machine.model.pose("rest")
        announce(machine.plan_joints(rest, speed="slow"), machine, yes=yes)


def _until_enter() -> None:
    typer.prompt("Bring the arm into the pose, then press Enter", default="", show_default=False,
                 prompt_suffix=".", err=True)  # fmt: skip

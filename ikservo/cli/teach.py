"""``ikservo teach``: save the pose of an arm moved by hand under a name."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from ikservo.arm import Arm
from ikservo.calibration import JointUnit
from ikservo.cli.options import ArmOption, JsonOption, PortOption, UncalibratedOption, YesOption
from ikservo.cli.posture_reports import joint_lines
from ikservo.cli.session import announce_lowering, open_from_options
from ikservo.cli.terminal import print_json, print_lines, print_status, wait_for_enter
from ikservo.errors import InputError

__all__ = ["command"]

Name = Annotated[str, typer.Argument(metavar="NAME", help="1 to 64 of A-Z a-z 0-9 _ -")]
Now = Annotated[
    bool,
    typer.Option("--now", help="Save the present pose; torque stays as it is, nothing is asked."),
]
Hold = Annotated[bool, typer.Option("--hold", help="Switch torque on there afterwards.")]


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
    """Switch torque off, let you move the arm by hand, and save its pose under a name.

    ikservo teach cup --arm so101

    ikservo pose cup --arm so101
    """
    if not now and not sys.stdin.isatty():
        raise InputError(
            "Cannot ask: input is not a terminal.", "To save the present pose, add --now."
        )
    with open_from_options(arm, port, uncalibrated=uncalibrated) as machine:
        machine.poses.check_name(name)
        if not now:
            _confirm_relaxing(machine, yes=yes)
        positions = machine.teach(name, None if now else _wait_until_enter, hold=hold)
        path = machine.poses.path
    if json:
        print_json("teach", name=name, joints_rad=positions, path=str(path))
        return
    joints: dict[str, tuple[float, JointUnit]] = {
        joint: (position, machine.model.joint(joint).joint_map.unit)
        for joint, position in positions.items()
    }
    print_lines(joint_lines(joints))
    print_status(f'Saved pose "{name}" in {path}.')


def _confirm_relaxing(machine: Arm, *, yes: bool) -> None:
    if any(state.torque for state in machine.where().joints):
        announce_lowering(machine, yes=yes)


def _wait_until_enter() -> None:
    wait_for_enter("Bring the arm into the pose, then press Enter.")

"""``ikservo teach``: save the pose of an arm moved by hand under a name."""

from __future__ import annotations

import sys
from collections.abc import Callable, Generator
from contextlib import contextmanager
from typing import Annotated

import typer

from ikservo.apps.teaching.hand_guiding import guide_by_hand
from ikservo.arm import OpenArm
from ikservo.arm.opening import require_own_port
from ikservo.calibration import JointUnit
from ikservo.cli.open_and_confirm import announce_lowering, confirm_motion, open_from_options
from ikservo.cli.option_groups import Without
from ikservo.cli.options import ArmConnection, MotionOptions
from ikservo.cli.posture_reports import joint_lines
from ikservo.cli.quantities import parse_time_s
from ikservo.cli.terminal import (
    format_port,
    print_json,
    print_lines,
    print_status,
    read_keys,
    wait_for_enter,
)
from ikservo.errors import InputError

Name = Annotated[
    str, typer.Argument(metavar="NAME", help="Name of the pose: 1 to 64 of A-Z a-z 0-9 _ -")
]
Now = Annotated[
    bool,
    typer.Option(
        "--now", help="Save the present pose at once, without asking; torque does not change."
    ),
]
Hold = Annotated[
    bool, typer.Option("--hold", help="Afterwards, switch torque on and hold that pose.")
]
Float = Annotated[
    bool,
    typer.Option("--float", help="Keep torque on: the arm carries its weight and follows you."),
]
Duration = Annotated[
    float | None,
    typer.Option(
        "--for",
        parser=parse_time_s,
        metavar="TIME",
        help="With --float: end after this time, without a key press.",
    ),
]


def command(
    name: Name,
    *,
    connection: ArmConnection,
    now: Now = False,
    hold: Hold = False,
    floating: Float = False,
    duration: Duration = None,
    options: Annotated[MotionOptions, Without("collision", "dry_run", "no_wiggle", "tip")],
) -> None:
    """Save the pose of an arm under a name: torque is switched off, and you move the arm by hand.

    With --float torque stays on: the arm carries its weight, follows your hand, and then holds.

    ikservo teach cup --arm so101

    ikservo teach cup --float --arm so101

    ikservo pose cup --arm so101
    """
    _check_options(now=now, floating=floating, duration=duration)
    with open_from_options(connection, options) as machine:
        machine.poses.check_name(name)
        if not floating:
            _announce_teaching(machine, name, now=now, hold=hold)
        if name in machine.poses.user_poses():
            print_status(f'This replaces the pose "{name}" in {machine.poses.path}.')
        if floating:
            _float(machine, name, duration, yes=options.yes)
        elif not now and any(state.torque for state in machine.where().joints):
            announce_lowering(machine, options)
        prompt = "Move the arm to the pose, then press Enter."
        until = None if now or floating else lambda: wait_for_enter(prompt)
        positions = machine.teach(name, until, hold=hold)
        path = machine.poses.path
    if options.json:
        print_json("teach", name=name, joints_rad=positions, path=str(path))
        return
    joints: dict[str, tuple[float, JointUnit]] = {
        joint: (position, machine.model.joint(joint).joint_map.unit)
        for joint, position in positions.items()
    }
    print_lines(joint_lines(joints))
    print_status(f'Saved pose "{name}" in {path}.')


def _check_options(*, now: bool, floating: bool, duration: float | None) -> None:
    if floating and now:
        raise InputError("--float and --now cannot be used together.", "Leave one of them out.")
    if duration is not None and not floating:
        raise InputError("--for can only be used with --float.", "Add --float, or leave it out.")
    if not now and duration is None and not sys.stdin.isatty():
        hint = "Add --for, as in --for 20s." if floating else (
            "To save the present pose, add --now.")  # fmt: skip
        raise InputError("Cannot wait for Enter, because input is not a terminal.", hint)


def _float(machine: OpenArm, name: str, duration: float | None, *, yes: bool) -> None:
    """Announce and run hand guiding; the arm holds afterwards."""
    how = "until you press Enter" if duration is None else f"for {duration:g} s"
    print_status(
        f"{machine.model.title} on {format_port(machine.port_name)}: torque will be on, and the "
        f"servos carry the arm's weight {how}. Guide the arm by hand. Ctrl-C ends this, too. The "
        f'arm then holds, and its pose is saved as "{name}".'
    )
    confirm_motion(machine, yes=yes)
    with _end_check(machine, duration) as ended:
        guide_by_hand(require_own_port(machine), ended)
    print_status("The arm holds its position.")


@contextmanager
def _end_check(machine: OpenArm, duration: float | None) -> Generator[Callable[[], bool]]:
    """Yield a function that returns whether Enter was pressed or the duration is over."""
    if duration is None:
        with read_keys() as keys:
            yield lambda: bool(set(keys()) & {"\n", "\r"})
        return
    ends_s: list[float] = []

    def is_over() -> bool:
        now_s = machine.clock.now_s()
        if not ends_s:  # the time starts when guiding begins, after torque-on
            ends_s.append(now_s + duration)
        return now_s >= ends_s[0]

    yield is_over


def _announce_teaching(machine: OpenArm, name: str, *, now: bool, hold: bool) -> None:
    """Announce what will happen to the arm."""
    stiff = any(state.torque for state in machine.where().joints)
    as_it_is = "as it is" if now else "off"
    last = "torque comes on and the arm holds it" if hold else f"torque stays {as_it_is}"
    if now:
        print_status(f'The present pose is saved as "{name}"; {last}.')
        return
    first = "The arm is lowered and its torque goes off" if stiff else "Torque stays off"
    print_status(
        f'{first}; move the arm by hand. Press Enter to save its pose as "{name}"; then {last}.'
    )

"""``ikservo calibrate --wiggle``: small motions to confirm each joint and its direction."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from ikservo.arm import Arm, ZeroSource
from ikservo.cli.calibrate_screen import confirm_start
from ikservo.cli.session import open_from_options
from ikservo.cli.terminal import confirm as confirm_by_key
from ikservo.cli.terminal import print_json, print_lines, print_status
from ikservo.errors import CalibrationError, InputError
from ikservo.maintenance.direction_check import (
    DirectionCheck,
    confirm_directions,
    directions_confirmed,
    execute_lift,
    plan_clearance,
    plan_direction_check,
    plan_lift,
    run_direction_check,
)
from ikservo.model import Model

__all__ = ["check_directions", "check_directions_once", "check_new_signs"]


def check_directions_once(machine: Arm, *, yes: bool) -> bool:
    """Run the test motion of all joints if the present files were never confirmed with it.

    Returns whether it ran: the arm may then hold elsewhere than where a plan starts.

    An arm with unknown zeros moves in small steps that are each confirmed, without this.

    Args:
        machine: The arm, before it moves.
        yes: Whether to skip the questions to the user.

    Raises:
        CalibrationError: A joint is not the expected one.
        InputError: No user is there to observe.
    """
    if machine.is_remote:  # the program beside the arm has done it
        return False
    if machine.zeros in (ZeroSource.SIMULATED, ZeroSource.UNKNOWN):
        return False
    if directions_confirmed(machine.model, machine.port_name):
        return False
    print_status("Arm file or calibration changed: test motion first, each joint 5° and back.")
    _check_each_joint(machine, [], yes=yes)
    return True


def check_new_signs(
    model: Model, port: str | None, names: Sequence[str], *, interactive: bool
) -> bool:
    """Offer the test motion for joints whose sign is not the arm file's; return whether it ran.

    Until it was confirmed, the first motion of the arm starts with it.

    Raises:
        CalibrationError: The user saw a joint move in the wrong direction.
    """
    if not names:
        return True
    print_status(
        f"Sign opposite to the arm file: {', '.join(names)}. A small test motion checks it:"
    )
    print_status("torque comes on and each of them moves 5° and back.")
    if not (interactive and confirm_by_key("Make the test motion now?")):
        print_status(
            f"The first motion begins with it. By itself: ikservo calibrate {model.name} --wiggle"
        )
        return False
    with open_from_options(str(model.path), port, collisions=False) as machine:
        _check_each_joint(machine, names, yes=False)
    return True


def check_directions(machine: Arm, joints: Sequence[str], *, yes: bool, json: bool) -> None:
    """Run the test motion of some joints, all if none are named, and record all as confirmed."""
    motions = _check_each_joint(machine, joints, yes=yes)
    if json:
        print_json("wiggle", joints=list(map(_motion_fields, motions)), confirmed=not yes)
    else:
        print_lines([f"{motion.joint}: it moves {motion.direction}" for motion in motions])


def _motion_fields(motion: DirectionCheck) -> dict[str, object]:
    return {
        "joint": motion.joint,
        "displacement_rad": motion.travel,
        "description": motion.direction,
    }


def _check_each_joint(machine: Arm, joints: Sequence[str], *, yes: bool) -> list[DirectionCheck]:
    interactive = not yes and sys.stdin.isatty()
    if not (interactive or yes):
        raise InputError(
            "Cannot ask whether the joints move correctly: input is not a terminal.",
            "Without asking: --yes",
        )
    machine.enable()  # a limp arm sinks: motions are judged from where it holds
    # It may have sunk past a limit.
    machine.return_within_limits()
    _lift_clear(machine, interactive=interactive)
    motions: list[DirectionCheck] = []
    names = [machine.model.joint(name).name for name in joints]
    for name in names or [joint.name for joint in machine.model.joints]:
        _make_room(machine, name, interactive=interactive)
        motions.append(plan_direction_check(machine, name))
        _check_one_joint(machine, motions[-1], interactive=interactive)
    if len(motions) == len(machine.model.joints):
        confirm_directions(machine.model, machine.port_name)
    return motions


def _lift_clear(machine: Arm, *, interactive: bool) -> None:
    """Lift an arm that lies on something, so that its joints can move; it stays there."""
    motion = plan_lift(machine)
    if motion is not None:
        print_status(
            f"The arm rests on something: {motion.joint} moves {motion.direction}, and stays there."
        )
        execute_lift(machine, motion)
        _confirm_direction(machine, motion, interactive=interactive)


def _make_room(machine: Arm, name: str, *, interactive: bool) -> None:
    """Move another joint if one would collide in both directions of its test motion."""
    motion = plan_clearance(machine, name)
    if motion is not None:
        print_status(
            f"{motion.joint} moves {motion.direction}, and stays there: it is in the way of {name}."
        )
        execute_lift(machine, motion)
        _confirm_direction(machine, motion, interactive=interactive)


def _check_one_joint(machine: Arm, motion: DirectionCheck, *, interactive: bool) -> None:
    print_status(f"{motion.joint} moves {motion.direction}, then back.")
    run_direction_check(machine, motion)
    _confirm_direction(machine, motion, interactive=interactive)


def _confirm_direction(machine: Arm, motion: DirectionCheck, *, interactive: bool) -> None:
    if not confirm_start(
        f"Did {motion.joint} move {motion.direction}?", default=True, interactive=interactive
    ):
        raise CalibrationError(
            f"{motion.joint} does not move as in the arm file; torque stays on.",
            "If another joint moved: check the ids in the arm file. If it went the other way: "
            f"ikservo calibrate {machine.model.name} --joint {motion.joint}",
        )

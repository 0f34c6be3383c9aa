"""``ikservo calibrate --wiggle``: a person sees that each joint is the one it should be."""

from __future__ import annotations

import sys
from collections.abc import Sequence

from ikservo.arm import Arm, Zeros
from ikservo.arm.calibrating.confirmation import confirm, confirmed
from ikservo.arm.calibrating.wiggling import Wiggle, expected, lift, lifting, making_room, wiggle
from ikservo.cli.calibrating.meeting import consent
from ikservo.cli.output import note, print_json, print_lines
from ikservo.cli.prompts import confirm as confirm_by_key
from ikservo.cli.session import opened
from ikservo.errors import CalibrationError, InputError
from ikservo.model import Model

__all__ = ["check_new_signs", "check_once", "wiggle_all"]


def check_once(machine: Arm, *, yes: bool) -> bool:
    """Wiggle every joint before the first motion with files that nobody has seen obeyed.

    Returns whether it did: the arm may then hold elsewhere than where a plan begins.

    An arm whose zeros nobody knows goes in small steps that are each agreed to, without this.

    Args:
        machine: The arm, before it moves.
        yes: Whether nobody is asked what they saw.

    Raises:
        CalibrationError: A joint is not the one it should be.
        InputError: Nobody is there to see.
    """
    if machine.zeros in (Zeros.SIMULATED, Zeros.UNKNOWN):
        return False
    if confirmed(machine.model, machine.port_name):
        return False
    note("Arm file or calibration changed: test motion first, each joint 5° and back.")
    _each(machine, [], yes=yes)
    return True


def check_new_signs(model: Model, port: str | None, names: Sequence[str], *, asks: bool) -> bool:
    """Offer the test motion for joints whose sign is not the arm file's; return whether it is done.

    Until it has been seen to be right, the first motion of the arm begins with it.

    Raises:
        CalibrationError: The person saw a joint go the wrong way.
    """
    if not names:
        return True
    note(f"Sign opposite to the arm file: {', '.join(names)}. A small test motion checks it:")
    note("torque comes on and each of them moves 5° and back.")
    if not (asks and confirm_by_key("Make the test motion now?")):
        note(f"The first motion begins with it. By itself: ikservo calibrate {model.name} --wiggle")
        return False
    with opened(str(model.path), port, collisions=False) as machine:
        _each(machine, names, yes=False)
    return True


def wiggle_all(machine: Arm, joints: Sequence[str], *, yes: bool, json: bool) -> None:
    """Make the test motion of some joints, all if none are named; note all as seen."""
    motions = _each(machine, joints, yes=yes)
    if json:
        print_json("wiggle", joints=motions, seen=not yes)
    else:
        print_lines([f"{motion.joint}: it moves {motion.words}" for motion in motions])


def _each(machine: Arm, joints: Sequence[str], *, yes: bool) -> list[Wiggle]:
    asks = not yes and sys.stdin.isatty()
    if not (asks or yes):
        raise InputError(
            "Cannot ask whether the joints move correctly: input is not a terminal.",
            "Without asking: --yes",
        )
    machine.enable()  # a limp arm sinks: what moves is judged from where it holds
    machine.workings.walk_back()  # it may have sunk past a limit, to which it could not return
    _lift_clear(machine, asks=asks)
    motions: list[Wiggle] = []
    names = [machine.model.joint(name).name for name in joints]
    for name in names or [joint.name for joint in machine.model.joints]:
        _make_room(machine, name, asks=asks)
        motions.append(expected(machine, name))
        _one(machine, motions[-1], asks=asks)
    if len(motions) == len(machine.model.joints):
        confirm(machine.model, machine.port_name)
    return motions


def _lift_clear(machine: Arm, *, asks: bool) -> None:
    """Lift an arm that lies on something, so that its joints can move; it stays there."""
    motion = lifting(machine)
    if motion is not None:
        note(f"The arm lies on something: {motion.joint} moves {motion.words}, and stays there.")
        lift(machine, motion)
        _check_seen(machine, motion, asks=asks)


def _make_room(machine: Arm, name: str, *, asks: bool) -> None:
    """Let another joint make room where one would touch something on each way it may go."""
    motion = making_room(machine, name)
    if motion is not None:
        note(f"{motion.joint} moves {motion.words}, and stays there: {name} needs room.")
        lift(machine, motion)
        _check_seen(machine, motion, asks=asks)


def _one(machine: Arm, motion: Wiggle, *, asks: bool) -> None:
    note(f"{motion.joint} moves {motion.words}, then back.")
    wiggle(machine, motion)
    _check_seen(machine, motion, asks=asks)


def _check_seen(machine: Arm, motion: Wiggle, *, asks: bool) -> None:
    if not consent(f"Did {motion.joint} move {motion.words}?", default=True, asks=asks):
        raise CalibrationError(
            f"{motion.joint} does not move as in the arm file; torque stays on.",
            "If another joint moved: check the ids in the arm file. If it went the other way: "
            f"ikservo calibrate {machine.model.name} --joint {motion.joint}",
        )

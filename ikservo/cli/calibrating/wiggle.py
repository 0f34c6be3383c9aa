"""``ikservo calibrate --wiggle``: a person sees that each joint is the one it should be."""

from __future__ import annotations

import sys

from ikservo.arm import Arm, Zeros
from ikservo.arm.calibrating.confirmation import confirm, confirmed
from ikservo.arm.calibrating.wiggling import Wiggle, expected, wiggle
from ikservo.cli.calibrating.meeting import consent
from ikservo.cli.output import note, print_json, print_lines
from ikservo.errors import CalibrationError, InputError

__all__ = ["check_once", "wiggle_all"]


def check_once(machine: Arm, *, yes: bool) -> None:
    """Wiggle every joint before the first motion with files that nobody has seen obeyed.

    An arm whose zeros nobody knows goes in small steps that are each agreed to, without this.

    Args:
        machine: The arm, before it moves.
        yes: Whether nobody is asked what they saw.

    Raises:
        CalibrationError: A joint is not the one it should be.
        InputError: Nobody is there to see.
    """
    if machine.zeros in (Zeros.SIMULATED, Zeros.UNKNOWN):
        return
    if confirmed(machine.model, machine.port_name):
        return
    note("The arm's files are new or have changed: first each joint moves a little, and back.")
    _each(machine, yes=yes)


def wiggle_all(machine: Arm, *, yes: bool, json: bool) -> None:
    """Wiggle every joint and note that they are right."""
    motions = _each(machine, yes=yes)
    if json:
        print_json("wiggle", joints=motions, seen=not yes)
    else:
        print_lines([f"{motion.joint}: it moves {motion.words}" for motion in motions])


def _each(machine: Arm, *, yes: bool) -> list[Wiggle]:
    asks = not yes and sys.stdin.isatty()
    if not (asks or yes):
        raise InputError(
            "Nobody is here to say whether the joints move as they should.",
            "Give --yes where nobody needs to look.",
        )
    motions: list[Wiggle] = []
    for joint in machine.model.joints:
        motions.append(expected(machine, joint.name))
        _one(machine, motions[-1], asks=asks)
    confirm(machine.model, machine.port_name)
    return motions


def _one(machine: Arm, motion: Wiggle, *, asks: bool) -> None:
    note(f"{motion.joint} moves {motion.words}, then back.")
    wiggle(machine, motion)
    if not consent(f"Did {motion.joint} move {motion.words}?", default=True, asks=asks):
        raise CalibrationError(
            f"{motion.joint} does not move as the arm's files say; the arm holds.",
            "Another joint moved: look at the ids in the arm file. It went the other way: "
            f"calibrate it: ikservo calibrate {machine.model.name}",
        )

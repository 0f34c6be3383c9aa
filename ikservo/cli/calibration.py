"""``ikservo calibration``: what the file says and what the servos hold, brought together."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Annotated

import typer

from ikservo.arm.calibrating.adopting import adopt, adoptable
from ikservo.arm.calibrating.by_hand import LooseArm, loose_arm
from ikservo.arm.calibrating.filing import differences, pull, push
from ikservo.calibration.in_servos.transaction import resume, revert
from ikservo.cli.calibrating.meeting import consent, let_go
from ikservo.cli.calibrating.options import ArmWord
from ikservo.cli.choosing import chosen_model
from ikservo.cli.completing import actions
from ikservo.cli.options import JsonOption, PortOption, YesOption
from ikservo.cli.output import note, print_json, print_lines, print_table
from ikservo.errors import ExitCode, IkservoError, InputError, UnknownNameError

__all__ = ["command"]

ACTIONS = ("diff", "push", "pull", "adopt", "resume", "revert")
Action = Annotated[
    str,
    typer.Argument(
        metavar="diff|push|pull|adopt|resume|revert",
        autocompletion=actions,
        help="Compare; file into servos; servos into file; adopt the one of another adapter; "
        "complete or revert an interrupted write.",
    ),
]
Source = Annotated[
    Path | None, typer.Option("--from", metavar="FILE", help="The calibration to adopt.")
]


def command(
    action: Action,
    arm: ArmWord = None,
    *,
    port: PortOption = None,
    source: Source = None,
    yes: YesOption = False,
    json: JsonOption = False,
) -> None:
    """Compare an arm's calibration with its servos, or carry one over to the other.

    ikservo calibration diff so101          exit 6 where they differ

    ikservo calibration push so101          write the file into the servos

    ikservo calibration pull so101          write the servos into the file

    ikservo calibration adopt so101         the arm is on another adapter than before
    """
    if action not in ACTIONS:
        raise UnknownNameError("action", action, ACTIONS)
    if source and action != "adopt":
        raise InputError(f"--from cannot be used with {action}.", "It belongs to: adopt")
    interrupted = action in ("resume", "revert")
    with loose_arm(chosen_model(arm), port, settled=not interrupted) as loose:
        if action == "diff":
            _diff(loose, json=json)
        elif interrupted:
            _interrupted(loose, action, yes=yes)
        elif action == "adopt":
            _adopt(loose, source, yes=yes)
        else:
            _carry(loose, action, yes=yes)


def _diff(loose: LooseArm, *, json: bool) -> None:
    found = differences(loose)
    if json:
        print_json("calibration-diff", path=loose.path, differences=found)
    elif found:
        rows = [[d.joint, str(d.servo_id), d.register, d.filed, d.found] for d in found]
        print_table(["joint", "id", "register", "file", "servo"], rows)
    else:
        print_lines(["Servos and calibration file agree."])
    if found:
        raise typer.Exit(ExitCode.CALIBRATION)


def _carry(loose: LooseArm, action: str, *, yes: bool) -> None:
    found = differences(loose)
    if not found:
        print_lines(["Servos and calibration file agree; nothing to do."])
        return
    for difference in found:
        note(str(difference))
    asks = not yes and sys.stdin.isatty()
    target = "the servos (torque goes off)" if action == "push" else str(loose.path)
    if not consent(f"Write this into {target}?", default=yes or asks, asks=asks):
        raise IkservoError("Cancelled; nothing was written.", "Without asking: --yes")
    path = push(loose) if action == "push" else pull(loose)
    print_lines([f"Servos and {path} agree."])


def _adopt(loose: LooseArm, source: Path | None, *, yes: bool) -> None:
    path, calibration = adoptable(loose, source)
    made_on = calibration.usb_serial_number or "without a number"
    note(f"{path}, made on adapter {made_on}: ids, models, offsets and limits match these servos.")
    asks = not yes and sys.stdin.isatty()
    if not consent("Is this the same arm?", default=yes, asks=asks):
        raise IkservoError("Cancelled; nothing was saved.", "Without asking: --yes")
    print_lines([f"Saved to {adopt(loose, calibration)}"])
    note(f"Check each joint: ikservo calibrate {calibration.arm} --wiggle")


def _interrupted(loose: LooseArm, action: str, *, yes: bool) -> None:
    if not loose.journal_path.exists():
        print_lines(["No interrupted write; nothing to do."])
        return
    let_go(loose, asks=not yes and sys.stdin.isatty(), yes=yes)
    step = resume if action == "resume" else revert
    step(loose.bus, loose.journal_path)
    done = "completed" if action == "resume" else "reverted"
    print_lines([f"The interrupted calibration was {done}."])

"""``ikservo calibrate``: this arm's own zeros, signs and ranges, found with a person's hands."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated

import typer

from ikservo.arm.calibrating import LooseArm, loose_arm
from ikservo.arm.own import simulated
from ikservo.arm.sketch import sketch
from ikservo.calibration import Limits
from ikservo.calibration.obstacles import findings
from ikservo.calibration.outcome import Outcome
from ikservo.calibration.sweep import Wizard
from ikservo.cli.calibrate_screen import screen
from ikservo.cli.calibrate_talk import answers, converse
from ikservo.cli.options import JsonOption, PortOption, YesOption
from ikservo.cli.output import note, print_json, print_lines
from ikservo.cli.quantities import parse_angle_rad, parse_length_m
from ikservo.cli.session import chosen_model
from ikservo.errors import BadValueError, IkservoError
from ikservo.model import Model

__all__ = [
    "ArmWord",
    "FromScript",
    "Margin",
    "NoInput",
    "Pose",
    "command",
    "consent",
    "greet",
    "let_go",
    "show",
]

ArmWord = Annotated[
    str | None,
    typer.Argument(metavar="[ARM]", envvar="IKSERVO_ARM", help="Arm: a name or an arm file."),
]
Pose = Annotated[str, typer.Option("--pose", help="The pose that the arm is held in at first.")]
Margin = Annotated[
    float, typer.Option("--margin", min=0.0, max=20.0, help="Degrees inside each end found.")
]
FromScript = Annotated[
    Path | None, typer.Option("--from-script", metavar="FILE", help="Answers, one a line.")
]
NoInput = Annotated[bool, typer.Option("--no-input", help="Never ask; a question is an error.")]
Free = Annotated[
    list[str] | None, typer.Option("--free", metavar="JOINT", help="Nothing stops this joint.")
]
Skip = Annotated[
    list[str] | None, typer.Option("--skip", metavar="JOINT", help="Leave it to the arm file.")
]
OwnLimit = Annotated[
    list[str] | None,
    typer.Option("--limit", metavar="JOINT=LOW:HIGH", help="A narrower range of your own."),
]
WriteLimits = Annotated[
    bool | None,
    typer.Option(
        "--write-limits/--no-write-limits", help="Whether the servos hold the limits, too."
    ),
]


def command(
    arm: ArmWord = None,
    *,
    port: PortOption = None,
    pose: Pose = "rest",
    margin: Margin = 2.0,
    free: Free = None,
    skip: Skip = None,
    limit: OwnLimit = None,
    write_limits: WriteLimits = None,
    from_script: FromScript = None,
    yes: YesOption = False,
    no_input: NoInput = False,
    json: JsonOption = False,
) -> None:
    """Find an arm's zeros, signs and ranges, moving it by hand; torque is off meanwhile.

    ikservo calibrate so101

    ikservo calibrate so101 --pose home --margin 1 --write-limits
    """
    model = chosen_model(arm)
    user = _own_limits(model, limit or [])
    asks = not (yes or no_input or from_script) and sys.stdin.isatty()
    with loose_arm(model, port) as loose:
        let_go(loose, asks=asks, yes=yes or from_script is not None)
        greet(loose, pose)
        wizard = Wizard.begin(loose.subjects(pose), math.radians(margin))
        with answers(from_script, yes=yes, ask=asks) as who, screen(model, pose) as shown:
            begun = _with_wishes(wizard, free or [], skip or [])
            wizard = converse(loose, begun, who, shown)
        outcome = _reviewed(loose, wizard, pose, user, write_limits, asks=asks)
        path = loose.save(outcome)
    show(outcome, wizard, path, json=json)


def consent(question: str, *, default: bool, asks: bool) -> bool:
    """Return a person's yes or no, or the default where nobody is asked."""
    return typer.confirm(question, default=default, err=True) if asks else default


def let_go(loose: LooseArm, *, asks: bool, yes: bool) -> None:
    """Switch torque off, once the person knows.

    Raises:
        IkservoError: Servos hold the arm and nobody agreed; nothing was changed.
    """
    if loose.settled:
        note(loose.settled)
    holding = loose.holding()
    if holding:
        note(f"{', '.join(holding)} hold: the arm will go limp. Hold it.")
        if not yes and not consent("Let go?", default=asks, asks=asks):
            raise IkservoError("Nothing was changed.", "Without asking: --yes")
    loose.let_go()


def greet(loose: LooseArm, pose: str) -> None:
    """Say who is on the line, and show the pose."""
    servos = list(loose.facts.values())
    counts = Counter(facts.table.model_name for facts in servos)
    listed = ", ".join(f"{count} {name}" for name, count in counts.items())
    firmware = ", ".join(sorted({facts.firmware for facts in servos}))
    note(f"{loose.model.title} on {loose.bus.port.name}: {listed}, firmware {firmware}.")
    for line in _picture(loose.model, pose):
        note(f"    {line}")


def _picture(model: Model, pose: str) -> list[str]:
    """Return the arm from its side in a pose; the sketch knows how to draw ``home``."""
    posed = replace(model, poses={**model.poses, "home": model.pose(pose)})
    return sketch(posed, model.joints[-1].name)[:-1]


def _with_wishes(wizard: Wizard, free: Sequence[str], skip: Sequence[str]) -> Wizard:
    """Return the conversation with what the command line already answered."""
    names = {wizard.subject(joint).name for joint in free}
    skipped = {wizard.subject(joint).name for joint in skip}
    return replace(wizard, free=frozenset(names), skipped=frozenset(skipped))


def _own_limits(model: Model, texts: Sequence[str]) -> Mapping[str, Limits]:
    limits: dict[str, Limits] = {}
    for text in texts:
        name, _, ends = text.partition("=")
        low, colon, high = ends.partition(":")
        if not colon:
            raise BadValueError("The limit", repr(text), "JOINT=LOW:HIGH, as in elbow_flex=-80:80")
        unit = model.joint(name).joint_map.unit
        parse = parse_length_m if unit == "m" else parse_angle_rad
        limits[name] = Limits.of(name, parse(low), parse(high), "user", unit)
    return limits


def _reviewed(
    loose: LooseArm,
    wizard: Wizard,
    pose: str,
    user: Mapping[str, Limits],
    write_limits: bool | None,
    *,
    asks: bool,
) -> Outcome:
    """Show what would be saved, and ask for it.

    Raises:
        IkservoError: The person said no; nothing was changed.
    """
    for line in findings(wizard):
        note(f"3  {line}")
    if not consent(f"Save to {loose.path}?", default=True, asks=asks):
        raise IkservoError("Nothing was saved or written.")
    question = "Write the same limits into the servos, so that they protect themselves?"
    own = consent(question, default=False, asks=asks) if write_limits is None else write_limits
    now = datetime.now(UTC)
    outcome = loose.conclude(wizard, pose, now, write_limits=own, user=user)
    for joint in outcome.calibration.joints:
        if joint.extended and own:
            note(f"3  {joint.name} counts on beyond one turn: its servo cannot hold its limits.")
    for line in loose.cut_by_servos(outcome):
        note(f"3  {line}")
    return outcome


def show(outcome: Outcome, wizard: Wizard, path: Path, *, json: bool) -> None:
    """Print what was saved."""
    calibration = outcome.calibration
    if json:
        joints = [joint.model_dump(exclude_none=True) for joint in calibration.joints]
        print_json(
            "calibrate", path=path, arm=calibration.arm, joints=joints, findings=[*findings(wizard)]
        )
        return
    print_lines([f"Saved to {path}"])
    if simulated(calibration.usb_serial_number):
        note("This simulated arm ends here; the next one is mounted as the arm file says.")
    else:
        note(f"Look at it: ikservo where --arm {calibration.arm}")

"""A calibration by hand: a person moves the joints, then looks at what would be saved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from ikservo.arm.calibrating.by_hand import LooseArm, loose_arm
from ikservo.arm.calibrating.confirmation import confirm
from ikservo.arm.calibrating.filing import lost_by_saving
from ikservo.arm.own import simulated
from ikservo.calibration import Limits
from ikservo.calibration.sweeping.answers import read_script
from ikservo.calibration.sweeping.obstacles import findings
from ikservo.calibration.sweeping.outcome import Outcome
from ikservo.calibration.sweeping.sweep import Wizard
from ikservo.cli.calibrating.meeting import consent, greet, let_go
from ikservo.cli.calibrating.screen import screen
from ikservo.cli.calibrating.talk import answers, converse
from ikservo.cli.output import note, print_json, print_lines
from ikservo.cli.quantities import parse_angle_rad, parse_length_m
from ikservo.errors import BadValueError, IkservoError
from ikservo.model import Model

__all__ = [
    "Wishes",
    "by_hand",
    "check_wishes",
    "own_limits",
    "reviewed",
    "show",
    "with_wishes",
]


@dataclass(frozen=True, slots=True)
class Wishes:
    """What the command line asks of a calibration.

    Attributes:
        pose: The named pose that the arm is in at first.
        margin_rad: How far inside each end the limits shall lie.
        free: Joints that nothing stops.
        skip: Joints left to the arm file.
        user: Ranges of the person's own, by joint.
        write_limits: Whether the servos hold the limits, too; None to ask.
        yes: Whether everything is agreed to.
        asks: Whether a person may be asked.
        json: Whether the answer is one JSON object.
    """

    pose: str
    margin_rad: float
    free: Sequence[str]
    skip: Sequence[str]
    user: Mapping[str, Limits]
    write_limits: bool | None
    yes: bool
    asks: bool
    json: bool

    def with_user(self, more: Mapping[str, Limits]) -> Wishes:
        """Return the wishes with narrower ranges of some joints, unless the person set them."""
        return replace(self, user={**more, **self.user})


def by_hand(model: Model, port: str | None, wishes: Wishes, script: Path | None) -> None:
    """Hold the conversation of a calibration by hand, and save what it ends with."""
    check_wishes(model, wishes, script)
    with loose_arm(model, port) as loose:
        let_go(loose, asks=wishes.asks, yes=wishes.yes or script is not None)
        greet(loose, wishes.pose)
        wizard = Wizard.begin(loose.subjects(wishes.pose), wishes.margin_rad)
        with (
            answers(script, yes=wishes.yes, ask=wishes.asks) as who,
            screen(model, wishes.pose) as shown,
        ):
            begun = with_wishes(wizard, wishes.free, wishes.skip)
            wizard = converse(loose, begun, who, shown)
        outcome = reviewed(loose, wizard, wishes)
        path = loose.save(outcome)
        if all(joint.sign_from == "by hand" for joint in outcome.calibration.joints):
            confirm(model, loose.bus.port.name)  # the hands have just shown which joint is which
    show(outcome, wizard, path, json=wishes.json)


def check_wishes(model: Model, wishes: Wishes, script: Path | None) -> None:
    """Refuse what would fail later, before an arm goes limp for it.

    Raises:
        CalibrationError: A range of the person's own has nothing in common with the arm file's.
        FileFormatError: The script is none.
        UnknownNameError: There is no such pose or joint.
    """
    model.pose(wishes.pose)
    for name in (*wishes.free, *wishes.skip):
        model.joint(name)
    for name, limits in wishes.user.items():
        model.joint(name).limits.intersect(limits)
    if script:
        read_script(script)


def with_wishes(wizard: Wizard, free: Sequence[str], skip: Sequence[str]) -> Wizard:
    """Return the conversation with what the command line already answered."""
    names = {wizard.subject(joint).name for joint in free}
    skipped = {wizard.subject(joint).name for joint in skip}
    return replace(wizard, free=frozenset(names), skipped=frozenset(skipped))


def own_limits(model: Model, texts: Sequence[str]) -> Mapping[str, Limits]:
    """Return the ranges of ``--limit``, by joint.

    Raises:
        BadValueError: One is no range.
        UnknownNameError: The arm has no such joint.
    """
    limits: dict[str, Limits] = {}
    for text in texts:
        name, _, ends = text.partition("=")
        low, colon, high = ends.partition(":")
        if not colon:
            raise BadValueError("The limit", repr(text), "JOINT=LOW:HIGH, as in elbow_flex=-80:80")
        unit = model.joint(name).joint_map.unit
        parse = parse_length_m if unit == "m" else parse_angle_rad
        lower, upper = parse(low), parse(high)
        if not lower < upper:
            raise BadValueError(f"The limit of {name}", repr(ends), "the lower end first")
        limits[name] = Limits.of(name, lower, upper, "user", unit)
    return limits


def reviewed(loose: LooseArm, wizard: Wizard, wishes: Wishes) -> Outcome:
    """Show what would be saved, and ask for it.

    Raises:
        IkservoError: The person said no; nothing was changed.
    """
    for line in (*findings(wizard), *lost_by_saving(loose)):
        note(f"3  {line}")
    if not consent(f"Save to {loose.path}?", default=True, asks=wishes.asks):
        raise IkservoError("Nothing was saved or written.")
    own = _may_write_limits(wishes)
    now = datetime.now(UTC)
    outcome = loose.conclude(wizard, wishes.pose, now, write_limits=own, user=wishes.user)
    for joint in outcome.calibration.joints:
        if joint.extended and own:
            note(f"3  {joint.name} counts on beyond one turn: its servo cannot hold its limits.")
    for line in loose.cut_by_servos(outcome):
        note(f"3  {line}")
    return outcome


def _may_write_limits(wishes: Wishes) -> bool:
    if wishes.write_limits is not None:
        return wishes.write_limits
    question = "Write the same limits into the servos, so that they protect themselves?"
    return consent(question, default=False, asks=wishes.asks)


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

"""A calibration by hand: a person moves the joints, then looks at what would be saved."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path

from ikservo.arm.calibrating.by_hand import LooseArm, loose_arm
from ikservo.arm.calibrating.confirmation import confirm, confirmed
from ikservo.arm.calibrating.filing import lost_by_saving
from ikservo.arm.calibrating.rest_beyond import rest_beyond
from ikservo.arm.calibrating.single_joints import base_calibration, merged, replaced_zeros
from ikservo.arm.calibrating.steps import step_of
from ikservo.arm.own import simulated
from ikservo.calibration import Limits
from ikservo.calibration.filing.record import Calibration
from ikservo.calibration.sweeping.answers import read_script
from ikservo.calibration.sweeping.obstacles import findings
from ikservo.calibration.sweeping.outcome import Outcome
from ikservo.calibration.sweeping.plausibility import shifted_zeros
from ikservo.calibration.sweeping.sweep import Wizard
from ikservo.cli.calibrating.meeting import consent, greet, let_go, telling_what_is_left
from ikservo.cli.calibrating.screen import screen
from ikservo.cli.calibrating.talk import answers, converse
from ikservo.cli.calibrating.wiggle import check_new_signs
from ikservo.cli.output import note, print_json, print_lines
from ikservo.cli.quantities import parse_angle_rad, parse_length_m
from ikservo.errors import BadValueError, CalibrationError, IkservoError
from ikservo.model import Model

__all__ = [
    "Wishes",
    "by_hand",
    "check_wishes",
    "check_zeros",
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
        joints: Joints to be calibrated again; none for all.
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
    joints: Sequence[str]
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
        base = base_calibration(loose, wishes.joints) if wishes.joints else None
        known = base is None or confirmed(model, loose.bus.port.name)
        let_go(loose, asks=wishes.asks, yes=wishes.yes or script is not None)
        with telling_what_is_left():
            greet(loose, wishes.pose)
            wizard = _conversed(loose, wishes, script)
            outcome = reviewed(loose, wizard, wishes, base)
            path = loose.save(outcome)
        port_name = loose.bus.port.name
    show(outcome, wizard, path, json=wishes.json)
    opposite = [s.name for s in wizard.subjects if wizard.sign(s) != s.joint_map.sign]
    if simulated(outcome.calibration.usb_serial_number):
        return
    tested = check_new_signs(model, port, opposite, asks=wishes.asks)
    if known and tested and all(s.name in wizard.signs for s in wizard.subjects):
        confirm(model, port_name)  # each joint has been seen to move as the files say


def _conversed(loose: LooseArm, wishes: Wishes, script: Path | None) -> Wizard:
    """Return the conversation at its review."""
    subjects = loose.subjects(wishes.pose, only=wishes.joints)
    begun = with_wishes(Wizard.begin(subjects, wishes.margin_rad), wishes.free, wishes.skip)
    with (
        answers(script, yes=wishes.yes, ask=wishes.asks) as who,
        screen(loose.model, wishes.pose) as shown,
    ):
        return converse(loose, begun, who, shown)


def check_wishes(model: Model, wishes: Wishes, script: Path | None) -> None:
    """Refuse what would fail later, before an arm goes limp for it.

    Raises:
        CalibrationError: A range of the person's own has nothing in common with the arm file's.
        FileFormatError: The script is none.
        UnknownNameError: There is no such pose or joint.
    """
    model.pose(wishes.pose)
    for name in (*wishes.free, *wishes.skip, *wishes.joints):
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


def reviewed(
    loose: LooseArm, wizard: Wizard, wishes: Wishes, base: Calibration | None = None
) -> Outcome:
    """Show what would be saved, and ask for it.

    Args:
        loose: The arm.
        wizard: The conversation at its review.
        wishes: What the command line asks.
        base: The calibration of which some joints are replaced; None where all are new.

    Raises:
        CalibrationError: A zero is implausible, and the person did not vouch for the pose.
        IkservoError: The person said no; nothing was changed.
    """
    note(str(step_of(loose.model, wishes.pose, wizard)))
    lost = replaced_zeros(base, wishes.joints) if base else lost_by_saving(loose)
    for line in (*findings(wizard), *lost):
        note(f"  {line}")
    check_zeros(wizard, wishes.pose, loose.model.name, asks=wishes.asks)
    if not consent(f"Save to {loose.path}?", default=True, asks=wishes.asks):
        raise IkservoError("Cancelled; nothing was saved or written, torque is off.")
    own = _may_write_limits(wishes)
    now = datetime.now(UTC)
    outcome = loose.conclude(wizard, wishes.pose, now, write_limits=own, user=wishes.user)
    for joint in outcome.calibration.joints:
        if joint.extended and own:
            note(f"  {joint.name}: multi-turn mode; its servo cannot hold limits.")
    outcome = merged(base, outcome) if base else outcome
    for line in (
        *loose.cut_by_servos(outcome),
        *rest_beyond(loose.model, outcome.calibration),
    ):
        note(f"  {line}")
    return outcome


def check_zeros(wizard: Wizard, pose: str, arm: str, *, asks: bool) -> None:
    """Ask whether the arm was in its pose where a zero is implausible; refuse where nobody may be.

    Raises:
        CalibrationError: It was not, or nobody may be asked; nothing was changed.
    """
    shifted = list(shifted_zeros(wizard))
    for zero in shifted:
        note(f"  {zero}")
    names = ", ".join(zero.subject.name for zero in shifted)
    question = f'Was {names} exactly as in the pose "{pose}" at step 1?'
    if shifted and not consent(question, default=False, asks=asks):
        raise CalibrationError(
            f'The arm was not in the pose "{pose}": zero of {names} not plausible. '
            "Nothing was saved.",
            f"Calibrate again from the exact pose: ikservo calibrate {arm} --pose {pose}",
        )


def _may_write_limits(wishes: Wishes) -> bool:
    if wishes.write_limits is not None:
        return wishes.write_limits
    question = "Write the same limits into the servos, too?"
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
        note("This simulated arm ends here; the next one has the arm file's zeros and signs.")
    else:
        note(f"Check it: ikservo where --arm {calibration.arm}")

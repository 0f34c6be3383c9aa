"""``ikservo calibrate`` by hand: the dialogue while the user moves the joints, and the review."""

from __future__ import annotations

import sys
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

from ikservo.arm.calibrated_arm import is_simulated
from ikservo.calibration import Limits
from ikservo.calibration.procedure import (
    CalibrationStage,
    CalibrationState,
    blocking_issues,
    is_full_turn,
    warnings,
)
from ikservo.calibration.records import Calibration
from ikservo.calibration.result import CalibrationResult, find_shifted_zeros
from ikservo.calibration.script import ScriptedAnswers, apply_answer, read_script
from ikservo.cli.calibrate_screen import (
    CalibrationDisplay,
    calibration_display,
    confirm_start,
    disable_torque,
    print_servos,
    reporting_unchanged_state,
)
from ikservo.cli.direction_check import check_new_signs
from ikservo.cli.options import parse_angle_rad, parse_length_m
from ikservo.cli.terminal import Keys, print_json, print_lines, print_status, read_keys
from ikservo.errors import BadValueError, CalibrationError, IkservoError, InputError
from ikservo.maintenance.calibration_session import (
    TorqueOffArm,
    base_calibration,
    find_replaced_zeros,
    lost_geometry_warning,
    merge_outcome,
    open_torque_off,
    rest_pose_violations,
)
from ikservo.maintenance.calibration_steps import current_step
from ikservo.maintenance.direction_check import confirm_directions, directions_confirmed
from ikservo.model import Model

__all__ = [
    "AnswerSource",
    "CalibrationOptions",
    "answer_source",
    "apply_options",
    "calibrate_by_hand",
    "check_options",
    "check_zeros",
    "parse_limits",
    "print_result",
    "review",
    "run_calibration",
]


class AnswerSource(Protocol):
    """Who answers: a person, a script, or nobody but patience."""

    def next_answer(self, wizard: CalibrationState, at_s: float) -> str | None:
        """Return the next answer, if there is one now."""
        ...


def run_calibration(
    loose: TorqueOffArm,
    wizard: CalibrationState,
    who: AnswerSource,
    screen: CalibrationDisplay,
    stages: Sequence[CalibrationStage] = (CalibrationStage.REFERENCE_POSE, CalibrationStage.SWEEP),
) -> CalibrationState:
    """Read the servos and take answers as long as the conversation is at one of some stages.

    Raises:
        CalibrationError: Nobody is there to mend what is missing.
        BusError: The servos went silent.
    """
    while wizard.stage in stages:
        reading = loose.read_ticks()
        if reading is None:
            continue
        wizard = wizard.update(*reading)
        screen.show(wizard)
        word = who.next_answer(wizard, reading[0])
        if word:
            wizard = _apply_typed_answer(wizard, word, who, screen)
    return wizard


def _apply_typed_answer(
    wizard: CalibrationState, word: str, who: AnswerSource, screen: CalibrationDisplay
) -> CalibrationState:
    try:
        screen.print_message("")
        return apply_answer(wizard, word)
    except CalibrationError as error:
        if not isinstance(who, _TerminalAnswers):
            raise
        screen.print_message(f"{error.message} {error.command_hint}")
        return wizard


@contextmanager
def answer_source(script: Path | None, *, yes: bool, ask: bool) -> Generator[AnswerSource]:
    """Yield who answers.

    Args:
        script: A file of answers, if any.
        yes: Whether everything acceptable is accepted.
        ask: Whether a person may be asked.

    Raises:
        InputError: Nobody is there; names the options that answer instead.
    """
    if script:
        yield ScriptedAnswers(read_script(script))
    elif yes:
        yield ScriptedAnswers()
    elif ask and sys.stdin.isatty():
        with read_keys() as key:
            yield _TerminalAnswers(key)
    else:
        raise InputError(
            "Cannot ask: input is not a terminal.", "Give --yes, or --from-script FILE."
        )


class _TerminalAnswers:
    """A person at the keys; what they mean stands on the screen."""

    def __init__(self, key: Keys) -> None:
        self._key = key

    def next_answer(self, wizard: CalibrationState, at_s: float) -> str | None:
        """Return what the first of the keys pressed since the last reading means here."""
        key = self._key()[:1].lower()
        if key in ("\n", "\r"):
            return "accept"
        if key == "u":
            return "undo"
        verbs = {"s": "skip", "r": "remeasure", "f": "continuous"}
        if key in verbs and wizard.stage is CalibrationStage.SWEEP:
            joint = _joint_for_key(wizard, key)
            return f"{verbs[key]} {joint}" if joint else None
        return None


def _joint_for_key(wizard: CalibrationState, key: str) -> str:
    """Return the joint that a key is about: the asked one, else the first that is not right."""
    if key == "f":
        round_joints = [s.name for s in wizard.subjects if is_full_turn(wizard, s)]
        return next((name for name in round_joints if name not in wizard.free), "")
    if wizard.current_joint:
        return wizard.current_joint.name
    complaint = next(blocking_issues(wizard), None)
    names = [s.name for s in wizard.subjects if complaint and s.name in complaint.message]
    return next(iter(names), "")


@dataclass(frozen=True, slots=True)
class CalibrationOptions:
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

    def with_user_ranges(self, more: Mapping[str, Limits]) -> CalibrationOptions:
        """Return the wishes with narrower ranges of some joints, unless the person set them."""
        return replace(self, user={**more, **self.user})


def calibrate_by_hand(
    model: Model, port: str | None, wishes: CalibrationOptions, script: Path | None
) -> None:
    """Hold the conversation of a calibration by hand, and save what it ends with."""
    check_options(model, wishes, script)
    with open_torque_off(model, port) as loose:
        base = base_calibration(loose, wishes.joints) if wishes.joints else None
        known = base is None or directions_confirmed(model, loose.bus.port.name)
        disable_torque(loose, asks=wishes.asks, yes=wishes.yes or script is not None)
        with reporting_unchanged_state():
            print_servos(loose, wishes.pose)
            wizard = _run_to_review(loose, wishes, script)
            outcome = review(loose, wizard, wishes, base)
            path = loose.save(outcome)
        port_name = loose.bus.port.name
    print_result(outcome, wizard, path, json=wishes.json)
    opposite = [s.name for s in wizard.subjects if wizard.sign(s) != s.joint_map.sign]
    if is_simulated(outcome.calibration.usb_serial_number):
        return
    tested = check_new_signs(model, port, opposite, asks=wishes.asks)
    if known and tested and all(s.name in wizard.signs for s in wizard.subjects):
        confirm_directions(model, port_name)  # each joint has been seen to move as the files say


def _run_to_review(
    loose: TorqueOffArm, wishes: CalibrationOptions, script: Path | None
) -> CalibrationState:
    """Return the conversation at its review."""
    subjects = loose.make_subjects(wishes.pose, only=wishes.joints)
    begun = apply_options(
        CalibrationState.begin(subjects, wishes.margin_rad), wishes.free, wishes.skip
    )
    with (
        answer_source(script, yes=wishes.yes, ask=wishes.asks) as who,
        calibration_display(loose.model, wishes.pose) as shown,
    ):
        return run_calibration(loose, begun, who, shown)


def check_options(model: Model, wishes: CalibrationOptions, script: Path | None) -> None:
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


def apply_options(
    wizard: CalibrationState, free: Sequence[str], skip: Sequence[str]
) -> CalibrationState:
    """Return the conversation with what the command line already answered."""
    names = {wizard.find_joint(joint).name for joint in free}
    skipped = {wizard.find_joint(joint).name for joint in skip}
    return replace(wizard, free=frozenset(names), skipped=frozenset(skipped))


def parse_limits(model: Model, texts: Sequence[str]) -> Mapping[str, Limits]:
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


def review(
    loose: TorqueOffArm,
    wizard: CalibrationState,
    wishes: CalibrationOptions,
    base: Calibration | None = None,
) -> CalibrationResult:
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
    print_status(str(current_step(loose.model, wishes.pose, wizard)))
    lost = find_replaced_zeros(base, wishes.joints) if base else lost_geometry_warning(loose)
    for line in (*warnings(wizard), *lost):
        print_status(f"  {line}")
    check_zeros(wizard, wishes.pose, loose.model.name, asks=wishes.asks)
    if not confirm_start(f"Save to {loose.path}?", default=True, asks=wishes.asks):
        raise IkservoError("Cancelled; nothing was saved or written, torque is off.")
    own = _may_write_limits(wishes)
    now = datetime.now(UTC)
    outcome = loose.build_calibration(wizard, wishes.pose, now, write_limits=own, user=wishes.user)
    for joint in outcome.calibration.joints:
        if joint.extended and own:
            print_status(f"  {joint.name}: multi-turn mode; its servo cannot hold limits.")
    outcome = merge_outcome(base, outcome) if base else outcome
    for line in (
        *loose.register_limit_warnings(outcome),
        *rest_pose_violations(loose.model, outcome.calibration),
    ):
        print_status(f"  {line}")
    return outcome


def check_zeros(wizard: CalibrationState, pose: str, arm: str, *, asks: bool) -> None:
    """Ask whether the arm was in its pose where a zero is implausible; refuse where nobody may be.

    Raises:
        CalibrationError: It was not, or nobody may be asked; nothing was changed.
    """
    shifted = list(find_shifted_zeros(wizard))
    for zero in shifted:
        print_status(f"  {zero}")
    names = ", ".join(zero.subject.name for zero in shifted)
    question = f'Was {names} exactly as in the pose "{pose}" at step 1?'
    if shifted and not confirm_start(question, default=False, asks=asks):
        raise CalibrationError(
            f'The arm was not in the pose "{pose}": zero of {names} not plausible. '
            "Nothing was saved.",
            f"Calibrate again from the exact pose: ikservo calibrate {arm} --pose {pose}",
        )


def _may_write_limits(wishes: CalibrationOptions) -> bool:
    if wishes.write_limits is not None:
        return wishes.write_limits
    question = "Write the same limits into the servos, too?"
    return confirm_start(question, default=False, asks=wishes.asks)


def print_result(
    outcome: CalibrationResult, wizard: CalibrationState, path: Path, *, json: bool
) -> None:
    """Print what was saved."""
    calibration = outcome.calibration
    if json:
        joints = [joint.model_dump(exclude_none=True) for joint in calibration.joints]
        print_json(
            "calibrate", path=path, arm=calibration.arm, joints=joints, findings=[*warnings(wizard)]
        )
        return
    print_lines([f"Saved to {path}"])
    if is_simulated(calibration.usb_serial_number):
        print_status(
            "This simulated arm ends here; the next one has the arm file's zeros and signs."
        )
    else:
        print_status(f"Check it: ikservo where --arm {calibration.arm}")

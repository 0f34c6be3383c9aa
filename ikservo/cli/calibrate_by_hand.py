"""``ikservo calibrate`` by hand: the dialogue while the user moves the joints, and the review."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

from ikservo.calibration import Limits
from ikservo.calibration.calibration_file import load_calibration_file
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
from ikservo.cli.answers import AnswerSource, answers_from, apply_or_explain
from ikservo.cli.calibrate_screen import (
    CalibrationDisplay,
    calibration_display,
    confirm_start,
    disable_torque,
    print_servos,
    reporting_unchanged_state,
)
from ikservo.cli.calibration_table import calibration_lines, difference_lines
from ikservo.cli.direction_check import check_new_signs
from ikservo.cli.options import parse_angle_rad, parse_length_m
from ikservo.cli.terminal import print_json, print_lines, print_status
from ikservo.errors import BadValueError, CalibrationError, FileFormatError, IkservoError
from ikservo.hardware.remembered_port import is_simulated
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
    "show_result",
]


def run_calibration(
    limp_arm: TorqueOffArm,
    state: CalibrationState,
    answers: AnswerSource[CalibrationState],
    display: CalibrationDisplay,
    stages: Sequence[CalibrationStage] = (CalibrationStage.REFERENCE_POSE, CalibrationStage.SWEEP),
) -> CalibrationState:
    """Read the servos and apply answers until the calibration leaves the given stages.

    Raises:
        CalibrationError: Something is missing, and no user is there to correct it.
        BusError: The servos stopped replying.
    """
    while state.stage in stages:
        reading = limp_arm.read_ticks()
        if reading is None:
            continue
        state = state.update(*reading)
        display.show(state)
        answer = answers.next_answer(state, reading[0])
        if answer:
            display.print_message("")
            state = apply_or_explain(
                partial(apply_answer, state, answer), state, answers, display.print_message
            )
    return state


def answer_source(
    script: Path | None, *, yes: bool, interactive: bool
) -> AbstractContextManager[AnswerSource[CalibrationState]]:
    """Return the source of answers.

    Args:
        script: A file of answers, if any.
        yes: Whether everything acceptable is accepted.
        interactive: Whether the user may be asked.

    Raises:
        FileFormatError: The script cannot be read.
    """
    scripted = None
    if script or yes:
        scripted = ScriptedAnswers(read_script(script) if script else None)
    return answers_from(scripted, _answer_for_key, interactive=interactive)


def _answer_for_key(state: CalibrationState, key: str) -> str | None:
    if key in ("\n", "\r"):
        return "accept"
    if key == "u":
        return "undo"
    verbs = {"s": "skip", "r": "remeasure", "f": "continuous"}
    if key in verbs and state.stage is CalibrationStage.SWEEP:
        joint = _joint_for_key(state, key)
        return f"{verbs[key]} {joint}" if joint else None
    return None


def _joint_for_key(state: CalibrationState, key: str) -> str:
    """Return the joint that a key applies to: the current one, else the first with an issue."""
    if key == "f":
        round_joints = [s.name for s in state.subjects if is_full_turn(state, s)]
        return next((name for name in round_joints if name not in state.free), "")
    if state.current_joint:
        return state.current_joint.name
    issue = next(blocking_issues(state), None)
    names = [s.name for s in state.subjects if issue and s.name in issue.message]
    return next(iter(names), "")


@dataclass(frozen=True, slots=True)
class CalibrationOptions:
    """Options of a calibration.

    Attributes:
        pose: The named reference pose.
        margin_rad: Margin between each end stop and the limit.
        continuous: Joints without end stops.
        skip: Joints that keep the arm file's range and sign.
        joints: Joints to be calibrated again; none for all.
        user: Ranges set by the user, by joint.
        write_limits: Whether to write the limits into the servos; None to ask.
        yes: Whether everything is confirmed.
        interactive: Whether the user may be asked.
        json: Whether to print one JSON object.
    """

    pose: str
    margin_rad: float
    continuous: Sequence[str]
    skip: Sequence[str]
    joints: Sequence[str]
    user: Mapping[str, Limits]
    write_limits: bool | None
    yes: bool
    interactive: bool
    json: bool

    def with_user_ranges(self, more: Mapping[str, Limits]) -> CalibrationOptions:
        """Return the options with narrower ranges of some joints, unless the user set them."""
        return replace(self, user={**more, **self.user})


def calibrate_by_hand(
    model: Model, port: str | None, options: CalibrationOptions, script: Path | None
) -> None:
    """Run a calibration by hand, and save its result."""
    check_options(model, options, script)
    with open_torque_off(model, port) as limp_arm:
        base = base_calibration(limp_arm, options.joints) if options.joints else None
        known = base is None or directions_confirmed(model, limp_arm.bus.port.name)
        disable_torque(
            limp_arm, interactive=options.interactive, yes=options.yes or script is not None
        )
        with reporting_unchanged_state():
            print_servos(limp_arm, options.pose)
            state = _run_to_review(limp_arm, options, script)
            outcome = review(limp_arm, state, options, base)
            path = limp_arm.save(outcome)
        port_name = limp_arm.bus.port.name
    print_result(outcome, state, path, json=options.json)
    opposite = [s.name for s in state.subjects if state.sign(s) != s.joint_map.sign]
    if is_simulated(outcome.calibration.usb_serial_number):
        return
    tested = check_new_signs(model, port, opposite, interactive=options.interactive)
    if known and tested and all(s.name in state.signs for s in state.subjects):
        confirm_directions(model, port_name)  # each joint was observed to move as the files say


def _run_to_review(
    limp_arm: TorqueOffArm, options: CalibrationOptions, script: Path | None
) -> CalibrationState:
    """Return the calibration state at its review."""
    subjects = limp_arm.make_subjects(options.pose, only=options.joints)
    initial = apply_options(
        CalibrationState.begin(subjects, options.margin_rad), options.continuous, options.skip
    )
    with (
        answer_source(script, yes=options.yes, interactive=options.interactive) as answers,
        calibration_display(limp_arm.model, options.pose) as display,
    ):
        return run_calibration(limp_arm, initial, answers, display)


def check_options(model: Model, options: CalibrationOptions, script: Path | None) -> None:
    """Check the options before torque is switched off.

    Raises:
        CalibrationError: A range set by the user does not intersect the arm file's.
        FileFormatError: The script is invalid.
        UnknownNameError: There is no such pose or joint.
    """
    model.pose(options.pose)
    for name in (*options.continuous, *options.skip, *options.joints):
        model.joint(name)
    for name, limits in options.user.items():
        model.joint(name).limits.intersect(limits)
    if script:
        read_script(script)


def apply_options(
    state: CalibrationState, continuous: Sequence[str], skip: Sequence[str]
) -> CalibrationState:
    """Return the calibration state with the answers given as options."""
    names = {state.find_joint(joint).name for joint in continuous}
    skipped = {state.find_joint(joint).name for joint in skip}
    return replace(state, free=frozenset(names), skipped=frozenset(skipped))


def parse_limits(model: Model, texts: Sequence[str]) -> Mapping[str, Limits]:
    """Return the ranges of ``--limit``, by joint.

    Raises:
        BadValueError: One is not a range.
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
    limp_arm: TorqueOffArm,
    state: CalibrationState,
    options: CalibrationOptions,
    base: Calibration | None = None,
) -> CalibrationResult:
    """Show the result, and ask whether to save it.

    Args:
        limp_arm: The arm.
        state: The calibration state at its review.
        options: The options of the command.
        base: The calibration of which some joints are replaced; None if all are new.

    Raises:
        CalibrationError: A zero is implausible, and the user did not confirm the pose.
        IkservoError: The user declined; nothing was changed.
    """
    print_status(str(current_step(limp_arm.model, options.pose, state)))
    lost = find_replaced_zeros(base, options.joints) if base else lost_geometry_warning(limp_arm)
    for line in (*warnings(state), *lost):
        print_status(f"  {line}")
    check_zeros(state, options.pose, limp_arm.model.name, interactive=options.interactive)
    now = datetime.now(UTC)

    def build(*, write_limits: bool) -> CalibrationResult:
        found = limp_arm.build_calibration(
            state, options.pose, now, write_limits=write_limits, user=options.user
        )
        return merge_outcome(base, found) if base else found

    show_result(limp_arm, build(write_limits=False).calibration)
    if not confirm_start(
        f"Save to {limp_arm.path}?", default=True, interactive=options.interactive
    ):
        raise IkservoError("Cancelled; nothing was saved or written, torque is off.")
    write_limits = _may_write_limits(options)
    outcome = build(write_limits=write_limits)
    for joint in outcome.calibration.joints:
        if joint.extended and write_limits:
            print_status(f"  {joint.name}: multi-turn mode; its servo cannot hold limits.")
    for line in (
        *limp_arm.register_limit_warnings(outcome),
        *rest_pose_violations(limp_arm.model, outcome.calibration),
    ):
        print_status(f"  {line}")
    return outcome


def show_result(limp_arm: TorqueOffArm, calibration: Calibration) -> None:
    """Print what would be saved, and what differs from the file that it would replace."""
    for line in calibration_lines(calibration):
        print_status(f"  {line}")
    path = limp_arm.path
    try:
        old = load_calibration_file(path, calibration.arm)
    except FileFormatError as error:
        print_status(f"It replaces {path}, which is damaged: {error.where} {error.found}.")
        return
    if old is None:
        return
    changed = list(difference_lines(calibration, old))
    print_status(
        f"It replaces the calibration of {old.written:%Y-%m-%d}"
        + (":" if changed else ", whose zeros, signs and ranges are the same.")
    )
    for line in changed:
        print_status(f"  {line}")


def check_zeros(state: CalibrationState, pose: str, arm: str, *, interactive: bool) -> None:
    """Ask whether the arm was in its pose if a zero is implausible.

    Raises:
        CalibrationError: It was not, or the user may not be asked; nothing was changed.
    """
    shifted = list(find_shifted_zeros(state))
    for zero in shifted:
        print_status(f"  {zero}")
    names = ", ".join(zero.subject.name for zero in shifted)
    question = f'Was {names} exactly as in the pose "{pose}" at step 1?'
    if shifted and not confirm_start(question, default=False, interactive=interactive):
        raise CalibrationError(
            f'The arm was not in the pose "{pose}": zero of {names} not plausible. '
            "Nothing was saved.",
            f"Calibrate again from the exact pose: ikservo calibrate {arm} --pose {pose}",
        )


def _may_write_limits(options: CalibrationOptions) -> bool:
    if options.write_limits is not None:
        return options.write_limits
    question = "Write the same limits into the servos as well?"
    return confirm_start(question, default=False, interactive=options.interactive)


def print_result(
    outcome: CalibrationResult, state: CalibrationState, path: Path, *, json: bool
) -> None:
    """Print the saved calibration."""
    calibration = outcome.calibration
    if json:
        joints = [joint.model_dump(exclude_none=True) for joint in calibration.joints]
        print_json(
            "calibrate", path=path, arm=calibration.arm, joints=joints, findings=[*warnings(state)]
        )
        return
    print_lines([f"Saved to {path}"])
    if is_simulated(calibration.usb_serial_number):
        print_status(
            "This simulated arm ends here; the next one has the arm file's zeros and signs."
        )
    else:
        print_status(f"Check it: ikservo where --arm {calibration.arm}")

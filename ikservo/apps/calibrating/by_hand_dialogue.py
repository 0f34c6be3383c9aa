"""The dialogue of a calibration by hand: torque off, pose, directions, sweep, review.

Step 1 records the pose. Then follow one step per joint for its direction, the sweep, and the
review. The number of a skipped joint stays unused, so that the other numbers do not change.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path

from ikservo.apps.calibrating.by_hand_procedure import (
    MARGIN_RAD,
    CalibrationStage,
    CalibrationState,
    blocking_issues,
    is_full_turn,
    joint_readouts,
    range_complete,
    warnings,
)
from ikservo.apps.calibrating.calibration_result import CalibrationResult, find_shifted_zeros
from ikservo.apps.calibrating.calibration_session import (
    TorqueOffArm,
    find_replaced_zeros,
    lost_geometry_warning,
    merge_outcome,
    rest_pose_violations,
)
from ikservo.apps.calibrating.calibration_table import calibration_lines, difference_lines
from ikservo.apps.calibrating.range_tracker import NARROW_SWEEP_UNCHANGED_S, SWEEP_UNCHANGED_S
from ikservo.calibration import Limits
from ikservo.calibration.calibration_file import load_calibration_file
from ikservo.calibration.records import Calibration
from ikservo.calibration.uncalibrated_joint import JointUnderCalibration
from ikservo.errors import (
    BadValueError,
    CalibrationError,
    FileFormatError,
    IkservoError,
    InputError,
    shown,
)
from ikservo.files.writing import check_writable
from ikservo.maintenance.dialogue import (
    ACCEPT,
    Choice,
    Dialogue,
    HandRequest,
    Notice,
    Question,
    Unasked,
    read_answers,
)
from ikservo.model import Model
from ikservo.model.tool import describe_direction

ANSWERS = (ACCEPT, "undo", "remeasure JOINT", "skip JOINT", "continuous JOINT")
_FORMER_VERBS = {"again": "remeasure", "free": "continuous"}


@dataclass(frozen=True, slots=True)
class CalibrationOptions:
    """Options of a calibration.

    Attributes:
        pose: The named reference pose.
        margin_rad: Margin between each end stop and the limit, angle of the horn.
        continuous: Joints without end stops.
        skip: Joints that keep the arm file's range and sign.
        joints: Joints to be calibrated again; empty: all joints.
        user: Ranges set by the user, by joint.
        write_limits: Whether to write the limits into the servos; None asks the user.
    """

    pose: str
    margin_rad: float = MARGIN_RAD
    continuous: Sequence[str] = ()
    skip: Sequence[str] = ()
    joints: Sequence[str] = ()
    user: Mapping[str, Limits] = field(default_factory=dict[str, Limits])
    write_limits: bool | None = None

    def check(self, model: Model) -> None:
        """Check the options before torque is switched off.

        Raises:
            CalibrationError: A range set by the user does not intersect the range in the arm file.
            UnknownNameError: There is no such pose or joint.
        """
        model.pose(self.pose)
        for name in (*self.continuous, *self.skip, *self.joints):
            model.joint(name)
        for name, limits in self.user.items():
            model.joint(name).limits.intersect(limits)

    def begin(self, limp_arm: TorqueOffArm) -> CalibrationState:
        """Return the initial state, including the answers that were given as options."""
        subjects = limp_arm.make_subjects(self.pose, only=self.joints)
        state = CalibrationState(subjects, self.margin_rad)
        free = frozenset(state.find_joint(joint).name for joint in self.continuous)
        skipped = frozenset(state.find_joint(joint).name for joint in self.skip)
        return replace(state, free=free, skipped=skipped)


def calibrate_by_hand(
    limp_arm: TorqueOffArm, options: CalibrationOptions, base: Calibration | None = None
) -> Dialogue[tuple[CalibrationState, CalibrationResult]]:
    """Calibrate a limp arm by hand; return the last state and the result to save.

    ``base`` is the calibration in which some joints are replaced; without it, all joints are new.

    Raises:
        CalibrationError: A zero is implausible, and the user did not confirm the pose.
        IkservoError: The user declined; nothing was changed.
        BusError: The servos stopped replying.
    """
    state, refused = options.begin(limp_arm), None
    while True:
        state = yield from record_ranges(limp_arm, state, options.pose, refused=refused)
        try:
            _build_outcome(limp_arm, state, options, base)
        except CalibrationError as error:  # the joint can still be measured again
            state, refused = state.undo(), error
            continue
        answer, outcome = yield from review(
            limp_arm, state, options, base, more=(Choice("undo", "undo"),)
        )
        if answer != "undo":
            return state, outcome
        state, refused = state.undo(), None


def switch_torque_off(limp_arm: TorqueOffArm) -> Dialogue[None]:
    """Switch torque off after the user has confirmed it.

    Raises:
        FileWriteError: The folder for the calibration is not writable.
        IkservoError: Servos hold the arm, and the user did not confirm; nothing was changed.
    """
    for path in (limp_arm.path, limp_arm.journal_path):
        check_writable(path.parent)
    if limp_arm.settled:
        yield Notice(limp_arm.settled)
    if limp_arm.torque_on_servos():
        yield Notice("Torque will be switched off; support the arm.")
        stage = CalibrationStage.REFERENCE_POSE
        if (
            yield Question("Switch torque off?", Unasked.NEEDS_YES, stage, "switch torque off")
        ) != ACCEPT:
            raise IkservoError(
                "Cancelled; nothing changed.", "To go on without being asked, add --yes."
            )
    limp_arm.disable_torque()


def record_ranges(
    limp_arm: TorqueOffArm,
    state: CalibrationState,
    pose: str,
    stages: Sequence[CalibrationStage] = (CalibrationStage.REFERENCE_POSE, CalibrationStage.SWEEP),
    refused: IkservoError | None = None,
) -> Dialogue[CalibrationState]:
    """Read the servos and apply answers until the calibration leaves the given stages.

    ``refused`` is the error of a refused answer that would have ended these stages.

    Raises:
        BusError: The servos stopped replying.
    """
    while state.stage in stages:
        reading = limp_arm.read_ticks()
        if reading is None:
            continue
        state = state.update(*reading)
        number, text = _request(limp_arm.model, pose, state)
        step = f"Step {number} of {len(state.subjects) + 3}"
        request = possible_answers(state, reading[0])
        answer = yield replace(request, step=step, text=text, error=refused)
        if answer:
            try:
                state, refused = apply_answer(state, answer), None
            except (CalibrationError, InputError) as error:
                refused = error
    return state


def apply_answer(state: CalibrationState, text: str) -> CalibrationState:
    """Apply an answer to the state.

    Raises:
        BadValueError: The text is not an answer.
        UnknownNameError: The arm has no joint of that name.
        CalibrationError: The answer cannot be accepted yet, because something is missing.
    """
    verb, _, joint = text.strip().partition(" ")
    steps = {
        "remeasure": state.remeasure, "skip": state.skip, "continuous": state.mark_continuous,
    }  # fmt: skip
    if joint and verb in steps:
        return steps[verb](joint.strip())
    if text.strip() == ACCEPT:
        return state.accept()
    if text.strip() == "undo":
        return state.undo()
    raise BadValueError("The answer", shown(text), f"one of: {', '.join(ANSWERS)}")


def read_script(path: Path) -> list[str]:
    """Read the answers from a file, one per line; ``#`` begins a comment.

    Raises:
        FileFormatError: The file cannot be read, or a line is not an answer.
    """
    return read_answers(path, ANSWERS, _FORMER_VERBS)


def possible_answers(state: CalibrationState, at_s: float) -> HandRequest:
    """Return the possible answers, as a request without text, for a state read at a time [s]."""
    ranges = ((track.low, track.high) for track in state.tracks.values())
    current = state.current_joint
    if state.stage is CalibrationStage.REFERENCE_POSE:
        wait_s = 0.0 if state.is_at_rest else None
        choices = (Choice(ACCEPT, "record the pose", "Enter", wait_s),)
        missing = CalibrationError(
            "Timeout: the arm was still moving.", "Hold it still in the pose."
        )
    else:
        issue = next(blocking_issues(state), None)
        choices = _sweep_choices(state, issue)
        missing = issue or CalibrationError("Timeout: no motion for 60 s.")
    return HandRequest(
        state.stage,
        "",
        "",
        at_s,
        choices,
        progress=(state.stage, current, *ranges),
        missing=missing,
        readings=tuple(joint_readouts(state)) if state.reference_ticks else (),
        current=current.name if current else "",
        ticks={i: track.tick for i, track in state.tracks.items()},
    )


def _sweep_choices(state: CalibrationState, issue: CalibrationError | None) -> tuple[Choice, ...]:
    """Return the possible answers of a sweep, each for the current joint or the joint at issue."""
    complete = all(range_complete(state, subject) for subject in state.subjects)
    wait_s = None if issue else SWEEP_UNCHANGED_S if complete else NARROW_SWEEP_UNCHANGED_S
    joints = tuple(subject.name for subject in state.subjects)
    named = [name for name in joints if issue and name in issue.message]
    joint = state.current_joint.name if state.current_joint else next(iter(named), "")
    turned = (s.name for s in state.subjects if s.name not in state.free and is_full_turn(state, s))
    return (
        Choice(ACCEPT, "every joint is done", "Enter", wait_s),
        Choice("skip", "skip", "s", joints=joints, joint=joint),
        Choice("undo", "undo", "u"),
        Choice("remeasure", "again", "r", joints=joints, joint=joint),
        Choice("continuous", "turns freely", "f", joints=joints, joint=next(turned, "")),
    )


def _request(model: Model, pose: str, state: CalibrationState) -> tuple[int, str]:
    """Return the number of the present calibration step, and the instruction for the user."""
    if state.stage is CalibrationStage.REFERENCE_POSE:
        what = f'Put the arm in the pose "{pose}"'
        if len(state.subjects) < len(model.joints):
            positions = [f"{s.name} at {s.joint_map.format(s.pose)}" for s in state.subjects]
            what = f'Put {", ".join(positions)} (pose "{pose}")'
        return (
            1,
            f"{what}. {'The arm is still; continue.' if state.is_at_rest else 'Hold it still …'}",
        )
    if state.current_joint:
        names = [subject.name for subject in state.subjects]
        number = names.index(state.current_joint.name) + 2
        return number, _direction_request(model, pose, state, state.current_joint)
    every = len(state.subjects) == len(model.joints)
    moved = "every joint" if every else ", ".join(subject.name for subject in state.subjects)
    done = all(range_complete(state, subject) for subject in state.subjects)
    go_on = " Continue once all have touched them." if done else ""
    return len(state.subjects) + 2, f"Move {moved} gently to both end stops.{go_on}"


def _direction_request(
    model: Model, pose: str, state: CalibrationState, subject: JointUnderCalibration
) -> str:
    direction = describe_direction(model, model.joint(subject.name), pose, subject.free_direction)
    if other := state.moved_instead:
        return (
            f"Move {subject.name} {direction}. Its servo has not moved, but that of {other.name} "
            f"has. If {other.name} only sank, go on. If you moved {subject.name}, their ids are "
            "interchanged: end this calibration, and set up both servos again."
        )
    if not state.is_second_trial:
        return f"Move {subject.name} {direction}; hold the others. Its ends are measured later."
    if state.returned:
        return f"Move {subject.name} again {direction}."
    return (
        f"{subject.name} turned opposite to the direction in the arm file. Was it first moved the "
        "wrong way, or did another joint move? Move every joint back to where it was."
    )


def review(
    limp_arm: TorqueOffArm,
    state: CalibrationState,
    options: CalibrationOptions,
    base: Calibration | None = None,
    *,
    more: tuple[Choice, ...] = (),
    may_have_sagged: bool = False,
) -> Dialogue[tuple[str, CalibrationResult]]:
    """Show the result, and ask whether to save it.

    ``more`` are answers besides saving, for a page with buttons.

    Returns:
        The answer, and the result to save.

    Raises:
        CalibrationError: A zero is implausible, and the user did not confirm the pose.
        IkservoError: The user declined; nothing was changed.
    """
    outcome = _build_outcome(limp_arm, state, options, base)
    steps = len(state.subjects) + 3
    yield Notice(f"Step {steps} of {steps}: Review and save.")
    lost = find_replaced_zeros(base, options.joints) if base else lost_geometry_warning(limp_arm)
    for line in (
        *warnings(state),
        *lost,
        *limp_arm.register_limit_warnings(outcome),
        *rest_pose_violations(limp_arm.model, outcome.calibration),
    ):
        yield Notice(f"  {line}")
    arm = limp_arm.model.name
    yield from check_zeros(state, options.pose, arm, may_have_sagged=may_have_sagged)
    protect = Choice("protect", "save, and write these limits into the servos as well")
    answer = yield from confirm_saving(limp_arm, outcome.calibration, (protect, *more))
    write_limits = answer == "protect" or options.write_limits
    if write_limits is None and answer == ACCEPT:
        question = "Write the same limits into the servos as well?"
        write_limits = (yield Question(question, Unasked.NO, CalibrationStage.REVIEW)) == ACCEPT
    if not write_limits:
        return answer, outcome
    for joint in outcome.calibration.joints:
        if joint.extended:
            yield Notice(f"  {joint.name}: the servo is in multi-turn mode and cannot hold limits.")
    limited = replace(options, write_limits=True)
    return answer, _build_outcome(limp_arm, state, limited, base)


def _build_outcome(
    limp_arm: TorqueOffArm,
    state: CalibrationState,
    options: CalibrationOptions,
    base: Calibration | None,
) -> CalibrationResult:
    """Build the calibration, with the limits in the servos if the options request it."""
    now = datetime.now(UTC)
    found = limp_arm.build_calibration(
        state, options.pose, now, write_limits=bool(options.write_limits), user=options.user
    )
    return merge_outcome(base, found) if base else found


def check_zeros(
    state: CalibrationState, pose: str, arm: str, *, may_have_sagged: bool = False
) -> Dialogue[None]:
    """Ask whether the arm was in its pose if a zero is implausible.

    After a calibration by hand, a smaller shift of both ends is only reported.

    Raises:
        CalibrationError: The arm was not in its pose, or nobody can be asked; nothing was changed.
    """
    shifted = list(find_shifted_zeros(state, may_have_sagged=may_have_sagged))
    for zero in find_shifted_zeros(state, may_have_sagged=True):
        yield Notice(f"  {zero}")
    if not shifted:
        return
    names = ", ".join(zero.subject.name for zero in shifted)
    question = f'Was {names} exactly as in the pose "{pose}" at step 1?'
    if (yield Question(question, Unasked.NO, CalibrationStage.REVIEW)) != ACCEPT:
        raise CalibrationError(
            f'The arm was not in the pose "{pose}": the zero of {names} is not plausible. '
            "Nothing was saved.",
            f"Calibrate again from the exact pose: ikservo calibrate {arm} --pose {pose}",
        )


def confirm_saving(
    limp_arm: TorqueOffArm, calibration: Calibration, more: tuple[Choice, ...] = ()
) -> Dialogue[str]:
    """Show what would be saved and replaced, and return the user's answer.

    ``more`` are answers besides ``accept``, for a page with buttons.

    Raises:
        IkservoError: The user declined; nothing was changed.
    """
    for line in calibration_lines(calibration):
        yield Notice(f"  {line}")
    for line in _replaced_lines(limp_arm.path, calibration):
        yield Notice(line)
    stage = CalibrationStage.REVIEW
    question = Question(f"Save to {limp_arm.path}?", Unasked.YES, stage, "save", more)
    answer = yield question
    if answer is None or not question.offers(answer):
        raise IkservoError("Cancelled; nothing was saved or written, torque is off.")
    return answer


def _replaced_lines(path: Path, calibration: Calibration) -> Iterator[str]:
    """Yield the differences from the calibration file that would be replaced, if there is one."""
    try:
        old = load_calibration_file(path, calibration.arm)
    except FileFormatError as error:
        yield f"This replaces {path}, which is damaged: {error.where} {error.found}."
        return
    if old is None:
        return
    changed = list(difference_lines(calibration, old))
    end = ":" if changed else ", whose zeros, signs and ranges are the same."
    yield f"This replaces the calibration from {old.written:%Y-%m-%d}{end}"
    yield from (f"  {line}" for line in changed)

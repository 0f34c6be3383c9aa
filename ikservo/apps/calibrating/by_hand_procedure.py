"""Calibration by hand as a pure state machine that maps readings and operator input to states.

``anchor -> sweep -> review -> saved``. It uses no terminal, no bus and no clock, so a terminal,
a web page and a test use the same procedure. Every step returns a new `CalibrationState`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from enum import StrEnum

from ikservo.apps.calibrating.range_tracker import RangeTracker
from ikservo.calibration.joint_limits import MIN_RANGE_TICKS
from ikservo.calibration.joint_map import format_position
from ikservo.calibration.uncalibrated_joint import JointUnderCalibration
from ikservo.control.stillness import StillnessDetector
from ikservo.errors import CalibrationError, UnknownNameError
from ikservo.maintenance.dialogue import JointProgress, JointReadout

# Fraction of a revolution; a joint with a wider range in the arm file has no stops.
_MAX_WIDTH_RATIO = 300 / 360
_ALMOST_FULL_TURN = 2 / 360
_COMPLETE = 0.8  # fraction of the arm file's range from which a range counts as complete
_MIRRORED_RAD = math.radians(30.0)
_SHADOW_TICKS = 40


def is_full_turn(state: CalibrationState, subject: JointUnderCalibration) -> bool:
    """Check whether a joint was moved so far that it cannot have end stops."""
    track = state.tracks[subject.servo_id]
    return subject.ticks_per_turn != 0 and track.width >= subject.ticks_per_turn * (
        1.0 - _ALMOST_FULL_TURN
    )


def range_complete(state: CalibrationState, subject: JointUnderCalibration) -> bool:
    """Check whether a joint's range seems complete."""
    if not state.is_measured(subject) or subject.name in state.free:
        return True
    width = state.tracks[subject.servo_id].width
    known = state.signs.keys() | state.known_signs
    return subject.name in known and width >= _COMPLETE * subject.expected_ticks


def blocking_issues(state: CalibrationState) -> Iterator[CalibrationError]:
    """Yield the issues that prevent the sweep from ending."""
    current = state.current_joint
    if current and state.is_second_trial:
        yield CalibrationError(
            f"{current.name} turned opposite to the direction in the arm file.",
            "Move it back, then again in the direction shown, or skip it.",
        )
    elif current:
        yield CalibrationError(f"{current.name} has not been moved yet.", "Move it, or skip it.")
    for subject in state.subjects:
        if state.is_measured(subject) and subject.name not in state.free:
            yield from _range_issues(state, subject)
        yield from _shadow_issues(state, subject)


def _range_issues(
    state: CalibrationState, subject: JointUnderCalibration
) -> Iterator[CalibrationError]:
    track, name = state.tracks[subject.servo_id], subject.name
    margins = 2 * state.margin_rad / subject.joint_map.horn_rad_per_tick
    if track.lost:
        yield CalibrationError(
            f"{name} was moved too fast to count its turns.", f"Measure {name} again, more slowly."
        )
    if track.width < MIN_RANGE_TICKS + margins:
        hint = "Move it gently to both ends, or skip it."
        yield CalibrationError(f"{name} was moved by only {track.width} ticks.", hint)
    expects_turn = subject.expected_ticks >= _MAX_WIDTH_RATIO * subject.ticks_per_turn
    if is_full_turn(state, subject) and not expects_turn:
        yield CalibrationError(
            f"{name} was moved by a full turn; the arm file expects "
            f"{_format_expected_range(subject)}.",
            "If it has no end stops, mark it as turning freely. Otherwise check for a loose horn.",
        )
    if _fits_better_mirrored(state, subject):
        ends = sorted(state.position(subject, tick) for tick in (track.low, track.high))
        yield CalibrationError(
            f"{name} was swept from {' to '.join(map(subject.joint_map.format, ends))}, but the "
            f"arm file says {_format_expected_range(subject)}; the sign or "
            "the pose is wrong.",
            f"Was it first moved the wrong way? Measure {name} again.",
        )


def _shadow_issues(
    state: CalibrationState, subject: JointUnderCalibration
) -> Iterator[CalibrationError]:
    lead = state.tracks[subject.servo_id]
    moved = lead.tick - state.reference_ticks[subject.servo_id]
    for shadow_id in subject.shadow_ids:
        shadow = state.tracks[shadow_id]
        if abs(shadow.tick - state.reference_ticks[shadow_id] - moved) > _SHADOW_TICKS:
            yield CalibrationError(
                f"Servos {subject.servo_id} and {shadow_id} of {subject.name} report different "
                "motions.",
                f"Does drive_mode of servo {shadow_id} match the arm file? Is a horn loose?",
            )


def warnings(state: CalibrationState) -> Iterator[str]:
    """Yield warnings for the user before saving, one line each."""
    for subject in state.subjects:
        name = subject.name
        if state.sign(subject) != subject.joint_map.sign:
            yield f"{name}: its sign, measured twice, contradicts the arm file."
        if name in state.skipped and name in state.reasons:
            yield f"{name}: {state.reasons[name]}"
        elif name in state.skipped:
            expected = _format_expected_range(subject)
            yield f"{name} was skipped: the arm file's range {expected} and sign are used."
        elif state.is_measured(subject) and (name in state.free or is_full_turn(state, subject)):
            expected = _format_expected_range(subject)
            yield f"{name} turns freely: the arm file's range {expected} is used."
        elif state.is_measured(subject) and not range_complete(state, subject):
            fraction = state.tracks[subject.servo_id].width / subject.expected_ticks
            yield f"{name} was swept over {fraction:.0%} of the arm file's range."


def _fits_better_mirrored(state: CalibrationState, subject: JointUnderCalibration) -> bool:
    """Check whether the range would fit much better with the opposite sign."""
    track = state.tracks[subject.servo_id]
    if is_full_turn(state, subject) or subject.joint_map.unit != "rad":
        return False
    sign, anchor = state.sign(subject), state.reference_ticks[subject.servo_id]
    lower, upper = subject.expected.lower.value, subject.expected.upper.value
    mismatches: dict[int, float] = {}  # distance of the recorded range from the expected one
    for each in (sign, -sign):
        placed = subject.with_mounting(each, anchor)
        low, high = sorted(placed.position(tick) for tick in (track.low, track.high))
        mismatches[each] = abs(low - lower) + abs(high - upper)
    return mismatches[sign] > _MIRRORED_RAD and mismatches[-sign] < mismatches[sign] / 3


def _format_expected_range(subject: JointUnderCalibration) -> str:
    low, high = subject.expected.lower.value, subject.expected.upper.value
    unit = subject.expected.unit
    return f"{format_position(low, unit)} to {format_position(high, unit)}"


MARGIN_RAD = math.radians(2.0)

_RETURNED_FRACTION = 1 / 3  # of the motion that shows a direction; a closer joint has returned
_MOVED_INSTEAD = 1.5  # of the same motion, by another joint


class CalibrationStage(StrEnum):
    """The stage of the procedure."""

    REFERENCE_POSE = "anchor"
    SWEEP = "sweep"
    REVIEW = "review"
    SAVED = "saved"


@dataclass(frozen=True, slots=True)
class CalibrationState:
    """The state of one calibration.

    Attributes:
        subjects: The joints, base to tip.
        margin_rad: Distance between each limit and the end found by hand, angle of the horn.
        stage: The stage of the procedure.
        tracks: Position and range of each servo, by id; the second servo of a joint included.
        stillness: The readings of the last half second.
        reference_ticks: The tick of each servo in the reference pose, by id.
        signs: Directions that were found so far, by joint.
        unconfirmed_signs: Directions that were found once and contradict the arm file, by joint;
            such a joint must be moved again.
        returned: Whether the joint that must be moved again is back at its start.
        skipped: Joints that keep the arm file's range and sign.
        reasons: Reasons why joints could not be measured automatically, by joint.
        free: Joints that the user marked as having no stops.
        known_signs: Joints whose sign in the arm file is known to be right.
        motor_driven: Whether the servos, not the user, move the joints.
        direction_start: The ticks, by id, from which the current joint must be moved.
        before: The state before the last input.
    """

    subjects: tuple[JointUnderCalibration, ...]
    margin_rad: float = MARGIN_RAD
    stage: CalibrationStage = CalibrationStage.REFERENCE_POSE
    tracks: Mapping[int, RangeTracker] = field(default_factory=dict[int, RangeTracker])
    stillness: StillnessDetector = field(default_factory=StillnessDetector)
    reference_ticks: Mapping[int, float] = field(default_factory=dict[int, float])
    signs: Mapping[str, int] = field(default_factory=dict[str, int])
    unconfirmed_signs: Mapping[str, int] = field(default_factory=dict[str, int])
    returned: bool = False
    skipped: frozenset[str] = frozenset()
    reasons: Mapping[str, str] = field(default_factory=dict[str, str])
    free: frozenset[str] = frozenset()
    known_signs: frozenset[str] = frozenset()
    motor_driven: bool = False
    direction_start: Mapping[int, int] | None = None
    before: CalibrationState | None = None

    # --- queries ---

    @property
    def current_joint(self) -> JointUnderCalibration | None:
        """The joint to move in its shown direction now, if any."""
        if self.stage is not CalibrationStage.SWEEP:
            return None
        known = self.signs.keys() | self.skipped | self.known_signs
        return next((s for s in self.subjects if s.name not in known), None)

    @property
    def is_second_trial(self) -> bool:
        """Whether the current joint must be moved a second time to confirm its sign."""
        return self.current_joint is not None and self.current_joint.name in self.unconfirmed_signs

    @property
    def moved_instead(self) -> JointUnderCalibration | None:
        """The joint that moved far while the current joint, which should move, stayed still."""
        current = self.current_joint
        if current is None or self.is_second_trial:
            return None
        # A joint that has shown its direction may go on to its ends.
        known = self.signs.keys() | self.skipped | self.known_signs
        later = [s for s in self.subjects if s.name not in known]
        moved = {s.name: abs(self._moved_ticks(s)) / max(s.min_motion_ticks, 1.0) for s in later}
        if moved[current.name] > _RETURNED_FRACTION:
            return None
        other = max(later, key=lambda each: moved[each.name])
        return other if moved[other.name] > _MOVED_INSTEAD else None

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing has moved for half a second."""
        return self.stillness.is_at_rest()

    def find_joint(self, joint: str) -> JointUnderCalibration:
        """Find the joint with a name.

        Raises:
            UnknownNameError: The arm has no such joint.
        """
        named = {subject.name: subject for subject in self.subjects}
        if joint not in named:
            raise UnknownNameError("joint", joint, named)
        return named[joint]

    def sign(self, subject: JointUnderCalibration) -> int:
        """Return the sign that was found for a joint, or else the sign in the arm file."""
        return self.signs.get(subject.name, subject.joint_map.sign)

    def is_measured(self, subject: JointUnderCalibration) -> bool:
        """Check whether the joint's range is to be recorded by hand."""
        return subject.name not in self.skipped and subject.known is None

    def position(self, subject: JointUnderCalibration, tick: float) -> float:
        """Return a joint's position [rad or m] at a tick, once the reference pose is recorded."""
        placed = subject.with_mounting(self.sign(subject), self.reference_ticks[subject.servo_id])
        return placed.position(tick)

    # --- events ---

    def update(self, at_s: float, ticks: Mapping[int, int]) -> CalibrationState:
        """Add a reading of all servos at a time [s]: encoder ticks (no homing offset) by id."""
        ticks_per_turn_by_id = {
            i: s.ticks_per_turn for s in self.subjects for i in (s.servo_id, *s.shadow_ids)
        }
        tracks = {
            i: self.tracks[i].update(ticks[i], at_s)
            if i in self.tracks
            else RangeTracker.start_at(ticks_per_turn, ticks[i], at_s)
            for i, ticks_per_turn in ticks_per_turn_by_id.items()
        }
        counted = {i: track.tick for i, track in tracks.items()}
        after = replace(self, tracks=tracks, stillness=self.stillness.add_reading(at_s, counted))
        return after._update_direction()

    def update_unwrapped(self, at_s: float, ticks: Mapping[int, int]) -> CalibrationState:
        """Add encoder ticks that the servo driver has already unwrapped."""
        tracks = {i: track.update_unwrapped(ticks[i], at_s) for i, track in self.tracks.items()}
        return replace(self, tracks=tracks)

    def accept(self) -> CalibrationState:
        """Accept the reference pose, or end the sweep.

        Raises:
            CalibrationError: Something is missing; the message names it. The stage does not change.
        """
        if self.stage is CalibrationStage.REFERENCE_POSE:
            if not self.is_at_rest:
                hint = "Hold it still for half a second."
                raise CalibrationError("The arm is still moving.", hint)
            started = replace(
                self,
                stage=CalibrationStage.SWEEP,
                reference_ticks=self.stillness.mean_ticks(),
                tracks={i: track.restarted() for i, track in self.tracks.items()},
                before=self,
            )
            return started._update_direction()
        for issue in blocking_issues(self):
            raise issue
        return replace(self, stage=CalibrationStage.REVIEW, before=self)

    def undo(self) -> CalibrationState:
        """Undo the last input; tracking continues at the servos' positions."""
        if self.before is None:
            return self
        tracks = self.before.tracks if self.stage is CalibrationStage.SWEEP else self.tracks
        kept = {i: self.tracks[i].with_range_of(track) for i, track in tracks.items()}
        earlier = replace(self.before, tracks=kept, stillness=StillnessDetector())
        return replace(earlier, direction_start=None)._update_direction()

    def skip(self, joint: str, reason: str = "") -> CalibrationState:
        """Skip a joint: it keeps the arm file's sign and range."""
        name = self.find_joint(joint).name
        reasons = {**self.reasons, name: reason} if reason else self.reasons
        return self._remember_previous(
            skipped=self.skipped | {name}, reasons=reasons, direction_start=None
        )

    def mark_continuous(self, joint: str) -> CalibrationState:
        """Mark a joint as having no stops; its range is then the range in the arm file."""
        return self._remember_previous(free=self.free | {self.find_joint(joint).name})

    def remeasure(self, joint: str) -> CalibrationState:
        """Measure one joint again, including its direction."""
        subject = self.find_joint(joint)
        tracks = {**self.tracks, subject.servo_id: self.tracks[subject.servo_id].restarted()}
        return self._remember_previous(
            tracks=tracks,
            signs=_drop_joint(self.signs, joint),
            unconfirmed_signs=_drop_joint(self.unconfirmed_signs, joint),
            skipped=self.skipped - {joint},
            free=self.free - {joint},
            direction_start=None,
        )

    def _moved_ticks(self, subject: JointUnderCalibration) -> int:
        start = (self.direction_start or {}).get(subject.servo_id)
        return 0 if start is None else self.tracks[subject.servo_id].tick - start

    def _remember_previous(self, **changes: object) -> CalibrationState:
        if self.stage is not CalibrationStage.SWEEP:
            hint = f"The calibration is in stage {self.stage}."
            raise CalibrationError("This is only possible during the sweep.", hint)
        after: CalibrationState = replace(self, before=self, **changes)  # pyright: ignore[reportArgumentType]
        return after._update_direction()

    def _update_direction(self) -> CalibrationState:
        """Store the start of the current joint, then its direction of motion.

        A sign that is opposite to the sign in the arm file must be found twice.
        """
        subject = self.current_joint
        if subject is None:
            return self
        if self.direction_start is None:
            return replace(self, direction_start={i: each.tick for i, each in self.tracks.items()})
        moved = self._moved_ticks(subject)
        if self.is_second_trial and not self.returned:
            back = abs(moved) < _RETURNED_FRACTION * subject.min_motion_ticks
            return replace(self, returned=True) if back else self
        if abs(moved) < subject.min_motion_ticks:
            return self
        name = subject.name
        sign = subject.free_direction if moved > 0 else -subject.free_direction
        if sign != subject.joint_map.sign and name not in self.unconfirmed_signs:
            return self._remember_previous(
                unconfirmed_signs={**self.unconfirmed_signs, name: sign}, returned=False
            )
        return self._remember_previous(signs={**self.signs, name: sign}, direction_start=None)


def _drop_joint(signs: Mapping[str, int], joint: str) -> dict[str, int]:
    return {name: sign for name, sign in signs.items() if name != joint}


def joint_readouts(state: CalibrationState) -> Iterator[JointReadout]:
    """Yield the readout of each joint, once the reference pose is recorded."""
    for subject in state.subjects:
        track = state.tracks[subject.servo_id]
        ends = sorted(state.position(subject, tick) for tick in (track.low, track.high))
        yield JointReadout(
            subject, _joint_progress(state, subject), state.position(subject, track.tick), *ends
        )


def _joint_progress(state: CalibrationState, subject: JointUnderCalibration) -> JointProgress:
    if subject.known:
        return JointProgress.KNOWN
    if subject.name in state.skipped:
        return JointProgress.SKIPPED
    if subject.name in state.free or is_full_turn(state, subject):
        return JointProgress.FREE
    if state.tracks[subject.servo_id].width < MIN_RANGE_TICKS:
        return JointProgress.UNMOVED
    return JointProgress.COMPLETE if range_complete(state, subject) else JointProgress.MOVING

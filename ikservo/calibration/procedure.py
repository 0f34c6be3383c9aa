"""The calibration by hand as a pure state machine: readings and answers in, states out.

``anchor -> sweep -> review -> saved``. It knows no terminal, no bus and no clock, so a terminal,
a page and a test drive the very same conversation. Every step returns a new `CalibrationState`.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import Enum, StrEnum

from ikservo.calibration.joint_map import format_position
from ikservo.calibration.range_tracker import JointUnderCalibration, RangeTracker, StillnessDetector
from ikservo.errors import CalibrationError, UnknownNameError

__all__ = [
    "MARGIN_RAD",
    "MIN_RANGE_TICKS",
    "CalibrationStage",
    "CalibrationState",
    "JointProgress",
    "JointReadout",
    "blocking_issues",
    "is_full_turn",
    "joint_readouts",
    "range_complete",
    "warnings",
]


MIN_RANGE_TICKS = 50  # a joint that moves less was not moved
_MAX_WIDTH_RATIO = 300 / 360  # of a turn: an arm file with such a range means a joint without stops
_ALMOST_FULL_TURN = 2 / 360
_COMPLETE = 0.8  # of the arm file's range
_MIRRORED_RAD = math.radians(30.0)
_SHADOW_TICKS = 40


def is_full_turn(wizard: CalibrationState, subject: JointUnderCalibration) -> bool:
    """Return whether a joint was turned so far that its range says nothing about stops."""
    track = wizard.tracks[subject.servo_id]
    return subject.turn > 0 and track.width >= subject.turn * (1.0 - _ALMOST_FULL_TURN)


def range_complete(wizard: CalibrationState, subject: JointUnderCalibration) -> bool:
    """Return whether a joint's range looks whole."""
    if not wizard.is_measured(subject) or subject.name in wizard.free:
        return True
    width = wizard.tracks[subject.servo_id].width
    known = wizard.signs.keys() | wizard.trusted
    return subject.name in known and width >= _COMPLETE * subject.expected_ticks


def blocking_issues(wizard: CalibrationState) -> Iterator[CalibrationError]:
    """Yield what still has to be done before the sweep can end."""
    yield from _direction_issues(wizard)
    for subject in wizard.subjects:
        if wizard.is_measured(subject) and subject.name not in wizard.free:
            yield from _range_issues(wizard, subject)
        yield from _shadow_issues(wizard, subject)


def _direction_issues(wizard: CalibrationState) -> Iterator[CalibrationError]:
    asked = wizard.current_joint
    if asked and wizard.is_second_trial:
        yield CalibrationError(
            f"{asked.name}: sign is opposite to the arm file. Was it first moved the wrong way?",
            "Move it back, then again in the direction shown, or skip it.",
        )
    elif asked:
        yield CalibrationError(f"{asked.name} has not been moved yet.", "Move it, or skip it.")


def _range_issues(
    wizard: CalibrationState, subject: JointUnderCalibration
) -> Iterator[CalibrationError]:
    track, name = wizard.tracks[subject.servo_id], subject.name
    margins = 2 * wizard.margin_rad / subject.joint_map.horn_rad_per_tick
    if track.lost:
        yield CalibrationError(
            f"{name} was moved too fast to count its turns.", f"Measure {name} again, slower."
        )
    if track.width < MIN_RANGE_TICKS + margins:
        yield CalibrationError(
            f"{name} was moved by only {track.width} ticks.",
            "Move it gently to both ends, or skip it.",
        )
    if is_full_turn(wizard, subject) and not _exceeds_expected_range(subject):
        yield CalibrationError(
            f"{name} was turned by a whole turn; "
            f"the arm file expects {_format_expected_range(subject)}.",
            f"Without end stops: mark {name} as turning freely. Else check for a loose horn.",
        )
    if _fits_better_mirrored(wizard, subject):
        yield CalibrationError(
            f"{name}: swept {_format_recorded_range(wizard, subject)}, "
            f"arm file {_format_expected_range(subject)}; the sign or "
            "the pose is wrong.",
            f"Was it first moved the wrong way? Measure {name} again.",
        )


def _shadow_issues(
    wizard: CalibrationState, subject: JointUnderCalibration
) -> Iterator[CalibrationError]:
    lead = wizard.tracks[subject.servo_id]
    moved = lead.tick - wizard.reference_ticks[subject.servo_id]
    for shadow_id in subject.shadow_ids:
        shadow = wizard.tracks[shadow_id]
        if abs(shadow.tick - wizard.reference_ticks[shadow_id] - moved) > _SHADOW_TICKS:
            yield CalibrationError(
                f"Servos {subject.servo_id} and {shadow_id} of {subject.name} report different "
                "motions.",
                f"Is drive_mode of servo {shadow_id} as in the arm file? Is a horn loose?",
            )


def warnings(wizard: CalibrationState) -> Iterator[str]:
    """Yield what the person should know before saving, one line each."""
    for subject in wizard.subjects:
        yield from _joint_warnings(wizard, subject)


def _joint_warnings(wizard: CalibrationState, subject: JointUnderCalibration) -> Iterator[str]:
    name = subject.name
    if wizard.sign(subject) != subject.joint_map.sign:
        yield f"{name}: sign is opposite to the arm file, measured twice."
    if name in wizard.skipped and name in wizard.reasons:
        yield f"{name}: {wizard.reasons[name]}"
    elif name in wizard.skipped:
        expected = _format_expected_range(subject)
        yield f"{name} was skipped: the arm file's range {expected} and sign are used."
    elif wizard.is_measured(subject) and (name in wizard.free or is_full_turn(wizard, subject)):
        expected = _format_expected_range(subject)
        yield f"{name} turns freely: the arm file's range {expected} is used."
    elif wizard.is_measured(subject) and not range_complete(wizard, subject):
        share = wizard.tracks[subject.servo_id].width / subject.expected_ticks
        yield f"{name} was swept over {share:.0%} of the arm file's range."


def _exceeds_expected_range(subject: JointUnderCalibration) -> bool:
    return subject.expected_ticks >= _MAX_WIDTH_RATIO * subject.turn


def _fits_better_mirrored(wizard: CalibrationState, subject: JointUnderCalibration) -> bool:
    """Return whether the range would fit much better the other way round."""
    track = wizard.tracks[subject.servo_id]
    if is_full_turn(wizard, subject) or subject.joint_map.unit != "rad":
        return False
    sign, anchor = wizard.sign(subject), wizard.reference_ticks[subject.servo_id]
    gaps = {s: _range_mismatch(subject, s, anchor, (track.low, track.high)) for s in (sign, -sign)}
    return gaps[sign] > _MIRRORED_RAD and gaps[-sign] < gaps[sign] / 3


def _range_mismatch(
    subject: JointUnderCalibration, sign: int, anchor: float, ticks: tuple[int, int]
) -> float:
    """Return how far a swept range lies from the expected one, with the servo mounted so."""
    placed = subject.with_mounting(sign, anchor)
    low, high = sorted(placed.position(tick) for tick in ticks)
    return abs(low - subject.expected.lower.value) + abs(high - subject.expected.upper.value)


def _format_recorded_range(wizard: CalibrationState, subject: JointUnderCalibration) -> str:
    track = wizard.tracks[subject.servo_id]
    ends = sorted(wizard.position(subject, tick) for tick in (track.low, track.high))
    return " to ".join(subject.joint_map.format(end) for end in ends)


def _format_expected_range(subject: JointUnderCalibration) -> str:
    low, high = subject.expected.lower.value, subject.expected.upper.value
    unit = subject.expected.unit
    return f"{format_position(low, unit)} to {format_position(high, unit)}"


MARGIN_RAD = math.radians(2.0)

_RETURNED_FRACTION = 1 / 3  # of the motion that shows a direction: a joint so close is back again


class CalibrationStage(StrEnum):
    """Where the conversation is."""

    REFERENCE_POSE = "anchor"
    SWEEP = "sweep"
    REVIEW = "review"
    SAVED = "saved"


@dataclass(frozen=True, slots=True)
class CalibrationState:
    """The state of one calibration.

    Attributes:
        subjects: The joints, base to tip.
        margin_rad: How far inside each end that a hand found the limit shall lie, horn's angle.
        stage: Where the conversation is.
        tracks: Where each servo is and has been, by id; shadows included.
        stillness: What was read in the last half second.
        reference_ticks: The tick of each servo in the anchor pose, by id.
        signs: Directions found so far, by joint.
        doubted: Directions found once that are opposite to the arm file's, by joint; such a joint
            is asked for again.
        returned: Whether the joint that is asked for again has come back to where it began.
        skipped: Joints that keep the arm file's range and sign.
        reasons: Why a joint is left out that a program could not measure, by joint.
        free: Joints that the person says nothing stops.
        trusted: Joints whose sign is believed as the arm file has it.
        motor_driven: Whether the servos move the joints, not a hand.
        asked_from: The tick from which the joint that is asked for shall move.
        before: The state before the person's last answer.
    """

    subjects: tuple[JointUnderCalibration, ...]
    margin_rad: float = MARGIN_RAD
    stage: CalibrationStage = CalibrationStage.REFERENCE_POSE
    tracks: Mapping[int, RangeTracker] = field(default_factory=dict[int, RangeTracker])
    stillness: StillnessDetector = field(default_factory=StillnessDetector)
    reference_ticks: Mapping[int, float] = field(default_factory=dict[int, float])
    signs: Mapping[str, int] = field(default_factory=dict[str, int])
    doubted: Mapping[str, int] = field(default_factory=dict[str, int])
    returned: bool = False
    skipped: frozenset[str] = frozenset()
    reasons: Mapping[str, str] = field(default_factory=dict[str, str])
    free: frozenset[str] = frozenset()
    trusted: frozenset[str] = frozenset()
    motor_driven: bool = False
    asked_from: int | None = None
    before: CalibrationState | None = None

    @classmethod
    def begin(
        cls, subjects: Sequence[JointUnderCalibration], margin_rad: float = MARGIN_RAD
    ) -> CalibrationState:
        """Return a conversation in which nothing has been said."""
        return cls(tuple(subjects), margin_rad)

    # --- what can be asked ---

    @property
    def current_joint(self) -> JointUnderCalibration | None:
        """Return the joint that shall now be moved in its shown direction, if any."""
        if self.stage is not CalibrationStage.SWEEP:
            return None
        settled = self.signs.keys() | self.skipped | self.trusted
        return next((s for s in self.subjects if s.name not in settled), None)

    @property
    def is_second_trial(self) -> bool:
        """Return whether the joint that is asked for moves a second time, its sign in doubt."""
        return self.current_joint is not None and self.current_joint.name in self.doubted

    @property
    def is_at_rest(self) -> bool:
        """Return whether nothing has moved for half a second."""
        return self.stillness.is_at_rest()

    def find_joint(self, joint: str) -> JointUnderCalibration:
        """Return the joint of that name.

        Raises:
            UnknownNameError: It is none of this arm's.
        """
        named = {subject.name: subject for subject in self.subjects}
        if joint not in named:
            raise UnknownNameError("joint", joint, named)
        return named[joint]

    def sign(self, subject: JointUnderCalibration) -> int:
        """Return a joint's sign: as found, else the arm file's."""
        return self.signs.get(subject.name, subject.joint_map.sign)

    def is_measured(self, subject: JointUnderCalibration) -> bool:
        """Return whether the joint's range is to be found by hand."""
        return subject.name not in self.skipped and subject.known is None

    def position(self, subject: JointUnderCalibration, tick: float) -> float:
        """Return a joint's position [rad or m] at a tick, once the anchor is taken."""
        placed = subject.with_mounting(self.sign(subject), self.reference_ticks[subject.servo_id])
        return placed.position(tick)

    # --- what can happen ---

    def update(self, at_s: float, ticks: Mapping[int, int]) -> CalibrationState:
        """Take a reading of all servos, bare ticks by id, at a time [s]."""
        turns = {i: s.turn for s in self.subjects for i in (s.servo_id, *s.shadow_ids)}
        tracks = {
            i: self.tracks[i].update(ticks[i], at_s)
            if i in self.tracks
            else RangeTracker.start_at(turn, ticks[i], at_s)
            for i, turn in turns.items()
        }
        counted = {i: track.tick for i, track in tracks.items()}
        after = replace(self, tracks=tracks, stillness=self.stillness.add_reading(at_s, counted))
        return after._update_direction()

    def update_unwrapped(self, at_s: float, ticks: Mapping[int, int]) -> CalibrationState:
        """Take bare ticks that are counted over the seam already, as the servos' driver knows."""
        tracks = {i: track.update_unwrapped(ticks[i], at_s) for i, track in self.tracks.items()}
        return replace(self, tracks=tracks)

    def accept(self) -> CalibrationState:
        """Go on: take the pose, end the sweep, or agree to what is to be saved.

        Raises:
            CalibrationError: Something is missing; says what, and the conversation stays.
        """
        if self.stage is CalibrationStage.REFERENCE_POSE:
            return self._take_anchor()
        if self.stage is CalibrationStage.SWEEP:
            for complaint in blocking_issues(self):
                raise complaint
            return replace(self, stage=CalibrationStage.REVIEW, before=self)
        return replace(self, stage=CalibrationStage.SAVED, before=None)

    def undo(self) -> CalibrationState:
        """Take the last answer back; readings go on from where the servos are."""
        if self.before is None or self.stage is CalibrationStage.SAVED:
            return self
        tracks = self.before.tracks if self.stage is CalibrationStage.SWEEP else self.tracks
        kept = {i: self.tracks[i].with_range_of(track) for i, track in tracks.items()}
        earlier = replace(self.before, tracks=kept, stillness=StillnessDetector())
        return replace(earlier, asked_from=None)._update_direction()

    def skip(self, joint: str, reason: str = "") -> CalibrationState:
        """Leave a joint out: it keeps the arm file's sign and range."""
        name = self.find_joint(joint).name
        reasons = {**self.reasons, name: reason} if reason else self.reasons
        return self._remember_previous(
            skipped=self.skipped | {name}, reasons=reasons, asked_from=None
        )

    def mark_continuous(self, joint: str) -> CalibrationState:
        """Say that nothing stops a joint: its range is the arm file's, however far it is turned."""
        return self._remember_previous(free=self.free | {self.find_joint(joint).name})

    def remeasure(self, joint: str) -> CalibrationState:
        """Measure one joint anew, its direction included."""
        subject = self.find_joint(joint)
        tracks = {**self.tracks, subject.servo_id: self.tracks[subject.servo_id].restarted()}
        return self._remember_previous(
            tracks=tracks,
            signs=_drop_joint(self.signs, joint),
            doubted=_drop_joint(self.doubted, joint),
            skipped=self.skipped - {joint},
            free=self.free - {joint},
            asked_from=None,
        )

    def _remember_previous(self, **changes: object) -> CalibrationState:
        if self.stage is not CalibrationStage.SWEEP:
            raise CalibrationError("Only possible during the sweep.", f"This is: {self.stage}.")
        after: CalibrationState = replace(self, before=self, **changes)  # pyright: ignore[reportArgumentType]
        return after._update_direction()

    def _take_anchor(self) -> CalibrationState:
        if not self.is_at_rest:
            raise CalibrationError("The arm is still moving.", "Hold it still for half a second.")
        begun = replace(
            self,
            stage=CalibrationStage.SWEEP,
            reference_ticks=self.stillness.mean_ticks(),
            tracks={i: track.restarted() for i, track in self.tracks.items()},
            before=self,
        )
        return begun._update_direction()

    def _update_direction(self) -> CalibrationState:
        """Note where the joint that is asked for starts, and which way it then goes."""
        subject = self.current_joint
        if subject is None:
            return self
        tick = self.tracks[subject.servo_id].tick
        if self.asked_from is None:
            return replace(self, asked_from=tick)
        moved = tick - self.asked_from
        if self.is_second_trial and not self.returned:
            back = abs(moved) < _RETURNED_FRACTION * subject.min_motion_ticks
            return replace(self, returned=True) if back else self
        if abs(moved) < subject.min_motion_ticks:
            return self
        return self._set_sign(
            subject, subject.free_direction if moved > 0 else -subject.free_direction
        )

    def _set_sign(self, subject: JointUnderCalibration, sign: int) -> CalibrationState:
        """Take a joint's sign; one that is opposite to the arm file's only the second time."""
        name = subject.name
        if sign != subject.joint_map.sign and name not in self.doubted:
            return self._remember_previous(doubted={**self.doubted, name: sign}, returned=False)
        return self._remember_previous(signs={**self.signs, name: sign}, asked_from=None)


def _drop_joint(signs: Mapping[str, int], joint: str) -> dict[str, int]:
    return {name: sign for name, sign in signs.items() if name != joint}


class JointProgress(Enum):
    """How far a joint has come."""

    UNMOVED = "not moved yet"
    MOVING = ""
    COMPLETE = "✓"
    FREE = "✓ turns freely"
    SKIPPED = "skipped"
    KNOWN = "✓ from LeRobot"


@dataclass(frozen=True, slots=True)
class JointReadout:
    """One joint: where it is, where it has been, and where the arm file expects it.

    Positions are rad or m.
    """

    subject: JointUnderCalibration
    state: JointProgress
    position: float
    low: float
    high: float

    @property
    def name(self) -> str:
        """Return the joint's name."""
        return self.subject.name


def joint_readouts(wizard: CalibrationState) -> Iterator[JointReadout]:
    """Yield a meter for each joint, once the anchor is taken."""
    for subject in wizard.subjects:
        track = wizard.tracks[subject.servo_id]
        ends = sorted(wizard.position(subject, tick) for tick in (track.low, track.high))
        yield JointReadout(
            subject, _joint_progress(wizard, subject), wizard.position(subject, track.tick), *ends
        )


def _joint_progress(wizard: CalibrationState, subject: JointUnderCalibration) -> JointProgress:
    if subject.known:
        return JointProgress.KNOWN
    if subject.name in wizard.skipped:
        return JointProgress.SKIPPED
    if subject.name in wizard.free or is_full_turn(wizard, subject):
        return JointProgress.FREE
    if wizard.tracks[subject.servo_id].width < MIN_RANGE_TICKS:
        return JointProgress.UNMOVED
    return JointProgress.COMPLETE if range_complete(wizard, subject) else JointProgress.MOVING

"""The calibration of an arm by hand as a pure machine: readings and answers in, states out.

``anchor -> sweep -> review -> saved``. It knows no terminal, no bus and no clock, so a terminal,
a page and a test drive the very same conversation. Every step returns a new `Wizard`.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum

from ikservo.calibration.sweeping.obstacles import obstacles
from ikservo.calibration.sweeping.stillness import Stillness
from ikservo.calibration.sweeping.subject import Subject
from ikservo.calibration.sweeping.track import Track
from ikservo.errors import CalibrationError, UnknownNameError

__all__ = ["MARGIN_RAD", "Stage", "Wizard"]

MARGIN_RAD = math.radians(2.0)

_RETURNED = 1 / 3  # of the motion that shows a direction: a joint so close is back again


class Stage(StrEnum):
    """Where the conversation is."""

    ANCHOR = "anchor"
    SWEEP = "sweep"
    REVIEW = "review"
    SAVED = "saved"


@dataclass(frozen=True, slots=True)
class Wizard:
    """The state of one calibration.

    Attributes:
        subjects: The joints, base to tip.
        margin_rad: How far inside each end that a hand found the limit shall lie, horn's angle.
        stage: Where the conversation is.
        tracks: Where each servo is and has been, by id; shadows included.
        stillness: What was read in the last half second.
        anchor: The tick of each servo in the anchor pose, by id.
        signs: Directions found so far, by joint.
        doubted: Directions found once that are opposite to the arm file's, by joint; such a joint
            is asked for again.
        returned: Whether the joint that is asked for again has come back to where it began.
        skipped: Joints that keep the arm file's range and sign.
        reasons: Why a joint is left out that a program could not measure, by joint.
        free: Joints that the person says nothing stops.
        trusted: Joints whose sign is believed as the arm file has it.
        driven: Whether the servos move the joints, not a hand.
        asked_from: The tick from which the joint that is asked for shall move.
        before: The state before the person's last answer.
    """

    subjects: tuple[Subject, ...]
    margin_rad: float = MARGIN_RAD
    stage: Stage = Stage.ANCHOR
    tracks: Mapping[int, Track] = field(default_factory=dict[int, Track])
    stillness: Stillness = field(default_factory=Stillness)
    anchor: Mapping[int, float] = field(default_factory=dict[int, float])
    signs: Mapping[str, int] = field(default_factory=dict[str, int])
    doubted: Mapping[str, int] = field(default_factory=dict[str, int])
    returned: bool = False
    skipped: frozenset[str] = frozenset()
    reasons: Mapping[str, str] = field(default_factory=dict[str, str])
    free: frozenset[str] = frozenset()
    trusted: frozenset[str] = frozenset()
    driven: bool = False
    asked_from: int | None = None
    before: Wizard | None = None

    @classmethod
    def begin(cls, subjects: Sequence[Subject], margin_rad: float = MARGIN_RAD) -> Wizard:
        """Return a conversation in which nothing has been said."""
        return cls(tuple(subjects), margin_rad)

    # --- what can be asked ---

    @property
    def asked(self) -> Subject | None:
        """Return the joint that shall now be moved in its shown direction, if any."""
        if self.stage is not Stage.SWEEP:
            return None
        settled = self.signs.keys() | self.skipped | self.trusted
        return next((s for s in self.subjects if s.name not in settled), None)

    @property
    def repeated(self) -> bool:
        """Return whether the joint that is asked for moves a second time, its sign in doubt."""
        return self.asked is not None and self.asked.name in self.doubted

    @property
    def still(self) -> bool:
        """Return whether nothing has moved for half a second."""
        return self.stillness.still()

    def subject(self, joint: str) -> Subject:
        """Return the joint of that name.

        Raises:
            UnknownNameError: It is none of this arm's.
        """
        named = {subject.name: subject for subject in self.subjects}
        if joint not in named:
            raise UnknownNameError("joint", joint, named)
        return named[joint]

    def sign(self, subject: Subject) -> int:
        """Return a joint's sign: as found, else the arm file's."""
        return self.signs.get(subject.name, subject.joint_map.sign)

    def measured(self, subject: Subject) -> bool:
        """Return whether the joint's range is to be found by hand."""
        return subject.name not in self.skipped and subject.known is None

    def position(self, subject: Subject, tick: float) -> float:
        """Return a joint's position [rad or m] at a tick, once the anchor is taken."""
        placed = subject.placed(self.sign(subject), self.anchor[subject.servo_id])
        return placed.position(tick)

    # --- what can happen ---

    def read(self, at_s: float, ticks: Mapping[int, int]) -> Wizard:
        """Take a reading of all servos, bare ticks by id, at a time [s]."""
        turns = {i: s.turn for s in self.subjects for i in (s.servo_id, *s.shadow_ids)}
        tracks = {
            i: self.tracks[i].seen(ticks[i], at_s)
            if i in self.tracks
            else Track.from_here(turn, ticks[i], at_s)
            for i, turn in turns.items()
        }
        counted = {i: track.tick for i, track in tracks.items()}
        after = replace(self, tracks=tracks, stillness=self.stillness.with_reading(at_s, counted))
        return after._with_direction()

    def counted(self, at_s: float, ticks: Mapping[int, int]) -> Wizard:
        """Take bare ticks that are counted over the seam already, as the servos' driver knows."""
        tracks = {i: track.counted(ticks[i], at_s) for i, track in self.tracks.items()}
        return replace(self, tracks=tracks)

    def accept(self) -> Wizard:
        """Go on: take the pose, end the sweep, or agree to what is to be saved.

        Raises:
            CalibrationError: Something is missing; says what, and the conversation stays.
        """
        if self.stage is Stage.ANCHOR:
            return self._anchored()
        if self.stage is Stage.SWEEP:
            for complaint in obstacles(self):
                raise complaint
            return replace(self, stage=Stage.REVIEW, before=self)
        return replace(self, stage=Stage.SAVED, before=None)

    def undo(self) -> Wizard:
        """Take the last answer back; readings go on from where the servos are."""
        if self.before is None or self.stage is Stage.SAVED:
            return self
        tracks = self.before.tracks if self.stage is Stage.SWEEP else self.tracks
        kept = {i: self.tracks[i].with_range_of(track) for i, track in tracks.items()}
        earlier = replace(self.before, tracks=kept, stillness=Stillness())
        return replace(earlier, asked_from=None)._with_direction()

    def skip(self, joint: str, reason: str = "") -> Wizard:
        """Leave a joint out: it keeps the arm file's sign and range."""
        name = self.subject(joint).name
        reasons = {**self.reasons, name: reason} if reason else self.reasons
        return self._answered(skipped=self.skipped | {name}, reasons=reasons, asked_from=None)

    def turns_freely(self, joint: str) -> Wizard:
        """Say that nothing stops a joint: its range is the arm file's, however far it is turned."""
        return self._answered(free=self.free | {self.subject(joint).name})

    def again(self, joint: str) -> Wizard:
        """Measure one joint anew, its direction included."""
        subject = self.subject(joint)
        tracks = {**self.tracks, subject.servo_id: self.tracks[subject.servo_id].again()}
        return self._answered(
            tracks=tracks,
            signs=_without(self.signs, joint),
            doubted=_without(self.doubted, joint),
            skipped=self.skipped - {joint},
            free=self.free - {joint},
            asked_from=None,
        )

    def _answered(self, **changes: object) -> Wizard:
        if self.stage is not Stage.SWEEP:
            raise CalibrationError("Only possible during the sweep.", f"This is: {self.stage}.")
        after: Wizard = replace(self, before=self, **changes)  # pyright: ignore[reportArgumentType]
        return after._with_direction()

    def _anchored(self) -> Wizard:
        if not self.still:
            raise CalibrationError("The arm is still moving.", "Hold it still for half a second.")
        begun = replace(
            self,
            stage=Stage.SWEEP,
            anchor=self.stillness.middle(),
            tracks={i: track.again() for i, track in self.tracks.items()},
            before=self,
        )
        return begun._with_direction()

    def _with_direction(self) -> Wizard:
        """Note where the joint that is asked for starts, and which way it then goes."""
        subject = self.asked
        if subject is None:
            return self
        tick = self.tracks[subject.servo_id].tick
        if self.asked_from is None:
            return replace(self, asked_from=tick)
        moved = tick - self.asked_from
        if self.repeated and not self.returned:
            back = abs(moved) < _RETURNED * subject.enough_ticks
            return replace(self, returned=True) if back else self
        if abs(moved) < subject.enough_ticks:
            return self
        return self._with_sign(subject, subject.towards if moved > 0 else -subject.towards)

    def _with_sign(self, subject: Subject, sign: int) -> Wizard:
        """Take a joint's sign; one that is opposite to the arm file's only the second time."""
        name = subject.name
        if sign != subject.joint_map.sign and name not in self.doubted:
            return self._answered(doubted={**self.doubted, name: sign}, returned=False)
        return self._answered(signs={**self.signs, name: sign}, asked_from=None)


def _without(signs: Mapping[str, int], joint: str) -> dict[str, int]:
    return {name: sign for name, sign in signs.items() if name != joint}

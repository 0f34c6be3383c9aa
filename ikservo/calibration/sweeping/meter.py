"""What a calibration shows of each joint while it is moved, as values."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from enum import Enum

from ikservo.calibration.sweeping.obstacles import LEAST_TICKS, complete, goes_round
from ikservo.calibration.sweeping.subject import Subject
from ikservo.calibration.sweeping.sweep import Wizard

__all__ = ["Meter", "State", "meters"]


class State(Enum):
    """How far a joint has come."""

    UNMOVED = "not moved yet"
    MOVING = ""
    COMPLETE = "✓"
    FREE = "✓ turns freely"
    SKIPPED = "skipped"
    KNOWN = "✓ from LeRobot"


@dataclass(frozen=True, slots=True)
class Meter:
    """One joint: where it is, where it has been, and where the arm file expects it.

    Positions are rad or m.
    """

    subject: Subject
    state: State
    position: float
    low: float
    high: float

    @property
    def name(self) -> str:
        """Return the joint's name."""
        return self.subject.name


def meters(wizard: Wizard) -> Iterator[Meter]:
    """Yield a meter for each joint, once the anchor is taken."""
    for subject in wizard.subjects:
        track = wizard.tracks[subject.servo_id]
        ends = sorted(wizard.position(subject, tick) for tick in (track.low, track.high))
        yield Meter(subject, _state(wizard, subject), wizard.position(subject, track.tick), *ends)


def _state(wizard: Wizard, subject: Subject) -> State:
    if subject.known:
        return State.KNOWN
    if subject.name in wizard.skipped:
        return State.SKIPPED
    if subject.name in wizard.free or goes_round(wizard, subject):
        return State.FREE
    if wizard.tracks[subject.servo_id].width < LEAST_TICKS:
        return State.UNMOVED
    return State.COMPLETE if complete(wizard, subject) else State.MOVING

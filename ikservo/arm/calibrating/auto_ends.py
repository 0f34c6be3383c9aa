"""Where stops are looked for, and whether what a joint met there can be one."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass

from ikservo.arm.calibrating.auto_feeling import Felt
from ikservo.arm.calibrating.auto_setup import BEYOND_RAD
from ikservo.calibration.sweeping.feeler import Touch
from ikservo.calibration.sweeping.subject import Subject
from ikservo.errors import CalibrationError

__all__ = ["End", "ends_of", "false_stop", "is_the_stop", "no_stop", "per_horn"]

_EARLY_RAD = math.radians(15.0)  # no stop is further than that from where the arm file has it


@dataclass(frozen=True, slots=True)
class End:
    """One end of a joint's range, rad or m.

    Attributes:
        joint: Whose.
        start: From where it is driven: the middle of its range.
        expected: Where the arm file has it.
        past: Where the joint is sent.
    """

    joint: str
    start: float
    expected: float
    past: float


def ends_of(subject: Subject) -> Iterator[End]:
    """Yield the lower and the upper end of a joint's range."""
    low, high = subject.expected.lower.value, subject.expected.upper.value
    beyond, middle = BEYOND_RAD * per_horn(subject), (low + high) / 2
    yield End(subject.name, middle, low, low - beyond)
    yield End(subject.name, middle, high, high + beyond)


def per_horn(subject: Subject) -> float:
    """Return what one radian of the horn is worth at most, rad or m."""
    return subject.joint_map.unit_per_tick / subject.joint_map.horn_rad_per_tick


def is_the_stop(felt: Felt, end: End, subject: Subject) -> bool:
    """Return whether a joint stands against its stop, not against something on the way."""
    short = (end.expected - felt.position) * math.copysign(1.0, end.past - end.start)
    return felt.touch is Touch.STOP and short <= _EARLY_RAD * per_horn(subject)


def false_stop(felt: Felt, end: End, subject: Subject) -> CalibrationError:
    """Return what to say of a joint that stands where its stop cannot be."""
    say = subject.joint_map.say
    if felt.touch is Touch.SLACK:
        return CalibrationError(
            f"{end.joint} stands at {say(felt.position)} although nothing holds it.",
            "Nothing was saved. Look at its supply, its cable and its alarms: ikservo where",
        )
    return CalibrationError(
        f"{end.joint} met something at {say(felt.position)}; its stop is expected at "
        f"{say(end.expected)}.",
        "Nothing was saved; the arm holds. Take away what stands there. If that is its stop, "
        "calibrate by hand: ikservo calibrate",
    )


def no_stop(felt: Felt, end: End, subject: Subject) -> CalibrationError:
    """Return what to say of a joint that went past where its stop is expected."""
    return CalibrationError(
        f"{end.joint} met no stop up to {subject.joint_map.say(felt.position)}.",
        "Nothing was saved. Was the arm in its pose when that was taken? If nothing stops the "
        f"joint: --free {end.joint}",
    )

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

__all__ = [
    "End",
    "ends_of",
    "false_stop",
    "is_the_stop",
    "nearly_a_turn",
    "no_stop",
    "per_horn",
    "unreached",
]

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
            f"{end.joint} does not move from {say(felt.position)} although no load was felt.",
            "Nothing was saved. Check supply, cable and alarms: ikservo where. Or leave it to the "
            f"arm file: --skip {end.joint}",
        )
    return CalibrationError(
        f"{end.joint} hit something at {say(felt.position)}; its end stop is expected at "
        f"{say(end.expected)}.",
        "Nothing was saved; torque stays on. Remove the obstacle. If that is its end stop, "
        f"calibrate by hand: ikservo calibrate. Or leave it to the arm file: --skip {end.joint}",
    )


def no_stop(felt: Felt, end: End, subject: Subject) -> CalibrationError:
    """Return what to say of a joint that went past where its stop is expected."""
    return CalibrationError(
        f"{end.joint} found no end stop up to {subject.joint_map.say(felt.position)}.",
        "Nothing was saved. Check that the arm was in the pose when it was recorded. If the "
        f"joint has no end stop: --free {end.joint}",
    )


def unreached(subject: Subject, lower: float | str, upper: float | str) -> str:
    """Return what to say of a joint of which an end cannot be looked for.

    Args:
        subject: The joint.
        lower: Where its lower stop was found, rad or m, or why it was not looked for.
        upper: Likewise.
    """
    say, expected = subject.joint_map.say, subject.expected
    ends = ((lower, expected.lower.value), (upper, expected.upper.value))
    reasons = [f"its end stop near {say(at)} ({why})" for why, at in ends if isinstance(why, str)]
    found = [f"the other is at {say(at)}" for at, _ in ends if isinstance(at, float)]
    kept = "the limit of the arm file is" if found else "both limits of the arm file are"
    missing = f"cannot search {', nor '.join(reasons)}; {kept} used there"
    return "; ".join([missing, *found]) + "."


def nearly_a_turn(subject: Subject) -> str:
    """Return what to say of a joint whose range leaves no room to look for stops."""
    say, expected = subject.joint_map.say, subject.expected
    low, high = expected.lower.value, expected.upper.value
    return (
        f"not searched: its range in the arm file, {say(low)} to {say(high)}, is nearly a whole "
        "turn or more; that range is used."
    )

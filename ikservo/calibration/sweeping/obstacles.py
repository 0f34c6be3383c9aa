"""Why a sweep cannot end yet, and what the person should know when it does."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import TYPE_CHECKING

from ikservo.calibration.sweeping.subject import Subject
from ikservo.calibration.ticks.words import say
from ikservo.errors import CalibrationError

if TYPE_CHECKING:
    from ikservo.calibration.sweeping.sweep import Wizard

__all__ = ["LEAST_TICKS", "complete", "findings", "goes_round", "obstacles"]

LEAST_TICKS = 50  # a joint that moves less was not moved
_ROOMY = 300 / 360  # of a turn: an arm file with such a range means a joint without stops
_NEARLY_A_TURN = 2 / 360
_COMPLETE = 0.8  # of the arm file's range
_MIRRORED_RAD = math.radians(30.0)
_SHADOW_TICKS = 40


def goes_round(wizard: Wizard, subject: Subject) -> bool:
    """Return whether a joint was turned so far that its range says nothing about stops."""
    track = wizard.tracks[subject.servo_id]
    return subject.turn > 0 and track.width >= subject.turn * (1.0 - _NEARLY_A_TURN)


def complete(wizard: Wizard, subject: Subject) -> bool:
    """Return whether a joint's range looks whole."""
    if not wizard.measured(subject) or subject.name in wizard.free:
        return True
    width = wizard.tracks[subject.servo_id].width
    known = wizard.signs.keys() | wizard.trusted
    return subject.name in known and width >= _COMPLETE * subject.expected_ticks


def obstacles(wizard: Wizard) -> Iterator[CalibrationError]:
    """Yield what still has to be done before the sweep can end."""
    yield from _of_direction(wizard)
    for subject in wizard.subjects:
        if wizard.measured(subject) and subject.name not in wizard.free:
            yield from _of_range(wizard, subject)
        yield from _of_shadows(wizard, subject)


def _of_direction(wizard: Wizard) -> Iterator[CalibrationError]:
    asked = wizard.asked
    if asked and wizard.repeated:
        yield CalibrationError(
            f"{asked.name}: sign is opposite to the arm file. Was it first moved the wrong way?",
            "Move it back, then again in the direction shown, or skip it.",
        )
    elif asked:
        yield CalibrationError(f"{asked.name} has not been moved yet.", "Move it, or skip it.")


def _of_range(wizard: Wizard, subject: Subject) -> Iterator[CalibrationError]:
    track, name = wizard.tracks[subject.servo_id], subject.name
    margins = 2 * wizard.margin_rad / subject.joint_map.horn_rad_per_tick
    if track.lost:
        yield CalibrationError(
            f"{name} was moved too fast to count its turns.", f"Measure {name} again, slower."
        )
    if track.width < LEAST_TICKS + margins:
        yield CalibrationError(
            f"{name} was moved by only {track.width} ticks.",
            "Move it gently to both ends, or skip it.",
        )
    if goes_round(wizard, subject) and not _roomy(subject):
        yield CalibrationError(
            f"{name} was turned by a whole turn; the arm file expects {_range(subject)}.",
            f"Without end stops: mark {name} as turning freely. Else check for a loose horn.",
        )
    if _mirrored(wizard, subject):
        yield CalibrationError(
            f"{name}: swept {_swept(wizard, subject)}, arm file {_range(subject)}; the sign or "
            "the pose is wrong.",
            f"Was it first moved the wrong way? Measure {name} again.",
        )


def _of_shadows(wizard: Wizard, subject: Subject) -> Iterator[CalibrationError]:
    lead = wizard.tracks[subject.servo_id]
    moved = lead.tick - wizard.anchor[subject.servo_id]
    for shadow_id in subject.shadow_ids:
        shadow = wizard.tracks[shadow_id]
        if abs(shadow.tick - wizard.anchor[shadow_id] - moved) > _SHADOW_TICKS:
            yield CalibrationError(
                f"Servos {subject.servo_id} and {shadow_id} of {subject.name} report different "
                "motions.",
                f"Is drive_mode of servo {shadow_id} as in the arm file? Is a horn loose?",
            )


def findings(wizard: Wizard) -> Iterator[str]:
    """Yield what the person should know before saving, one line each."""
    for subject in wizard.subjects:
        yield from _of_joint(wizard, subject)


def _of_joint(wizard: Wizard, subject: Subject) -> Iterator[str]:
    name = subject.name
    if wizard.sign(subject) != subject.joint_map.sign:
        yield f"{name}: sign is opposite to the arm file, measured twice."
    if name in wizard.skipped and name in wizard.reasons:
        yield f"{name}: {wizard.reasons[name]}"
    elif name in wizard.skipped:
        yield f"{name} was skipped: the arm file's range {_range(subject)} and sign are used."
    elif wizard.measured(subject) and (name in wizard.free or goes_round(wizard, subject)):
        yield f"{name} turns freely: the arm file's range {_range(subject)} is used."
    elif wizard.measured(subject) and not complete(wizard, subject):
        share = wizard.tracks[subject.servo_id].width / subject.expected_ticks
        yield f"{name} was swept over {share:.0%} of the arm file's range."


def _roomy(subject: Subject) -> bool:
    return subject.expected_ticks >= _ROOMY * subject.turn


def _mirrored(wizard: Wizard, subject: Subject) -> bool:
    """Return whether the range would fit much better the other way round."""
    track = wizard.tracks[subject.servo_id]
    if goes_round(wizard, subject) or subject.joint_map.unit != "rad":
        return False
    sign, anchor = wizard.sign(subject), wizard.anchor[subject.servo_id]
    gaps = {s: _gap(subject, s, anchor, (track.low, track.high)) for s in (sign, -sign)}
    return gaps[sign] > _MIRRORED_RAD and gaps[-sign] < gaps[sign] / 3


def _gap(subject: Subject, sign: int, anchor: float, ticks: tuple[int, int]) -> float:
    """Return how far a swept range lies from the expected one, with the servo mounted so."""
    placed = subject.placed(sign, anchor)
    low, high = sorted(placed.position(tick) for tick in ticks)
    return abs(low - subject.expected.lower.value) + abs(high - subject.expected.upper.value)


def _swept(wizard: Wizard, subject: Subject) -> str:
    track = wizard.tracks[subject.servo_id]
    ends = sorted(wizard.position(subject, tick) for tick in (track.low, track.high))
    return " to ".join(subject.joint_map.say(end) for end in ends)


def _range(subject: Subject) -> str:
    low, high = subject.expected.lower.value, subject.expected.upper.value
    return f"{say(low, subject.expected.unit)} to {say(high, subject.expected.unit)}"

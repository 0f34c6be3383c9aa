"""What a finished conversation means: the calibration to save and what the servos must hold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime

from ikservo.calibration.encoder import encoder_of
from ikservo.calibration.homing import X_MOST, Homing, Travel, choose_homing
from ikservo.calibration.joint_map import JointMap
from ikservo.calibration.limits import Limits
from ikservo.calibration.memory import ServoFacts, wanted_memory
from ikservo.calibration.obstacles import goes_round
from ikservo.calibration.record import CalibratedJoint, CalibratedServo, Calibration, Swept
from ikservo.calibration.seam import nearest_turn, short_way
from ikservo.calibration.subject import Subject
from ikservo.calibration.sweep import Wizard
from ikservo.errors import CalibrationError
from ikservo.registers import Family

__all__ = ["About", "Outcome", "conclude"]

_ALIKE_TICKS = 3  # servos of one joint that differ by less are as alike as their gears


@dataclass(frozen=True, slots=True)
class About:
    """What a calibration file says beside the joints."""

    arm: str
    written: datetime
    tool_version: str
    usb_serial_number: str
    family: Family
    anchor_pose: str


@dataclass(frozen=True, slots=True)
class Outcome:
    """A calibration, and the raw numbers each servo must hold for it, by id and register."""

    calibration: Calibration
    memory: Mapping[int, Mapping[str, int]]


def conclude(
    wizard: Wizard,
    facts: Mapping[int, ServoFacts],
    about: About,
    *,
    write_limits: bool = False,
    user: Mapping[str, Limits] | None = None,
) -> Outcome:
    """Work out the calibration of a conversation that has reached its review.

    Args:
        wizard: The conversation.
        facts: Every servo as it was found, by id.
        about: What else the file says.
        write_limits: Whether the servos shall hold the limits themselves.
        user: Ranges that the person set, by joint.

    Raises:
        CalibrationError: A joint travels a turn or more, or nothing is left of its range.
    """
    memory: dict[int, dict[str, int]] = {}
    joints = [
        _joint(wizard, subject, facts, (user or {}).get(subject.name), write_limits, memory)
        for subject in wizard.subjects
    ]
    calibration = Calibration(
        format=1,
        arm=about.arm,
        written=about.written,
        tool_version=about.tool_version,
        usb_serial_number=about.usb_serial_number,
        family=about.family,
        anchor_pose=about.anchor_pose,
        margin_deg=math.degrees(wizard.margin_rad),
        joints=tuple(joints),
    )
    return Outcome(calibration, memory)


def _joint(
    wizard: Wizard,
    subject: Subject,
    facts: Mapping[int, ServoFacts],
    user: Limits | None,
    write_limits: bool,
    memory: dict[int, dict[str, int]],
) -> CalibratedJoint:
    lead = facts[subject.servo_id]
    placed, travel, swept = _measured(wizard, subject)
    homing = choose_homing(
        subject.name,
        lead.table.family,
        travel,
        lead.offset,
        encoder_of(lead.table),
        counts_on=lead.counts_on and not subject.shadow_ids,
    )
    _refuse_lone_turns(subject, homing)
    placed = placed.placed(placed.sign, placed.zero_tick - homing.shift)
    ticks = (travel.low - homing.shift, travel.high - homing.shift)
    ends = _ends(placed, ticks, wizard.margin_rad) if swept != "not swept" else None
    limits = _limits(subject, ends, user)
    inside = placed.ticks_inside(limits.lower.value, limits.upper.value)
    registers = inside if write_limits and not homing.extended else None
    for servo_id, own in _homings(wizard, subject, facts, homing, ticks):
        memory[servo_id] = wanted_memory(facts[servo_id], own, registers)
    mode = memory[subject.servo_id].get("operating_mode")
    return CalibratedJoint(
        name=subject.name,
        sign=1 if placed.sign > 0 else -1,
        sign_from="by hand" if subject.name in wizard.signs else "arm file",
        zero_tick=placed.zero_tick,
        gear=placed.horn_rad_per_tick / placed.unit_per_tick if placed.unit == "rad" else 1.0,
        extended=lead.table.family is Family.DYNAMIXEL_2 and mode in (4, 5),
        swept=swept,
        travel_ticks=ticks,
        servo=_servo(lead, memory),
        shadows=tuple(_servo(facts[i], memory) for i in subject.shadow_ids),
        **_in_file_units("", ends, placed),
        **_in_file_units("user_", user and (user.lower.value, user.upper.value), placed),
    )


def _measured(wizard: Wizard, subject: Subject) -> tuple[JointMap, Travel, Swept]:
    """Return the joint's map in bare ticks, its travel in them, and how that was found."""
    track, anchor = wizard.tracks[subject.servo_id], wizard.anchor[subject.servo_id]
    placed = subject.placed(wizard.sign(subject), anchor)
    if subject.known:
        return placed, _around(subject, subject.known, anchor), "by LeRobot"
    name = subject.name
    if name in wizard.skipped or name in wizard.free or goes_round(wizard, subject):
        expected = subject.expected
        ends = placed.ticks_inside(expected.lower.value, expected.upper.value)
        return placed, Travel(*ends), "not swept"
    return placed, Travel(track.low, track.high), "by hand"


def _around(subject: Subject, known: Travel, anchor: float) -> Travel:
    """Return a travel moved by whole turns to where the anchor is."""
    shift = 0
    if subject.turn:
        middle = (known.low + known.high) // 2
        shift = nearest_turn(round(anchor), middle, subject.turn) - middle
    if not known.low + shift - 1 <= anchor <= known.high + shift + 1:
        raise CalibrationError(
            f"{subject.name} in the anchor pose is outside the range that LeRobot recorded.",
            "Is the arm in that pose, and is the file this arm's? Else: ikservo calibrate",
        )
    return Travel(known.low + shift, known.high + shift)


def _refuse_lone_turns(subject: Subject, homing: Homing) -> None:
    if homing.extended and subject.shadow_ids:
        raise CalibrationError(
            f"{subject.name} goes across the place where the count of servo {subject.servo_id} "
            "begins again, and two servos that turn one joint cannot both count on.",
            "Put its horns on so that the middle of the joint lies near tick 2048.",
        )


def _ends(placed: JointMap, ticks: tuple[int, int], margin_rad: float) -> tuple[float, float]:
    """Return the positions a margin inside both ends of a sweep."""
    margin = margin_rad / placed.horn_rad_per_tick
    low, high = sorted((placed.position(ticks[0] + margin), placed.position(ticks[1] - margin)))
    return low, high


def _limits(subject: Subject, ends: tuple[float, float] | None, user: Limits | None) -> Limits:
    limits = subject.expected
    if ends:
        limits = limits.intersect(Limits.of(subject.name, *ends, "hand sweep", limits.unit))
    return limits.intersect(user) if user else limits


def _homings(
    wizard: Wizard,
    subject: Subject,
    facts: Mapping[int, ServoFacts],
    homing: Homing,
    ticks: tuple[int, int],
) -> list[tuple[int, Homing]]:
    """Return how each servo of a joint is set up: shadows report what the first one does."""
    rows = [(subject.servo_id, homing)]
    reported = round(wizard.anchor[subject.servo_id] - homing.shift)
    for shadow_id in subject.shadow_ids:
        wanted = short_way(round(wizard.anchor[shadow_id]), reported, subject.turn)
        held = facts[shadow_id].offset
        offset = held if abs(wanted - held) <= _ALIKE_TICKS else wanted
        if abs(offset) > X_MOST or ticks[0] < offset or ticks[1] - offset >= subject.turn:
            raise CalibrationError(
                f"Servo {shadow_id} of {subject.name} stands {offset} ticks from servo "
                f"{subject.servo_id}; at most {X_MOST} can be made up for.",
                f"Put the horn of servo {shadow_id} on so that both count nearly alike.",
            )
        rows.append((shadow_id, Homing(offset, False, -offset)))
    return rows


def _servo(facts: ServoFacts, memory: Mapping[int, Mapping[str, int]]) -> CalibratedServo:
    return CalibratedServo(
        id=facts.id,
        model=facts.table.model_name,
        firmware=facts.firmware,
        holds=dict(memory[facts.id]),
    )


def _in_file_units(
    prefix: str, ends: tuple[float, float] | None, placed: JointMap
) -> dict[str, float]:
    if ends is None:
        return {}
    if placed.unit == "m":
        return {f"{prefix}lower_m": ends[0], f"{prefix}upper_m": ends[1]}
    low_deg, high_deg = map(math.degrees, ends)
    return {f"{prefix}lower_deg": low_deg, f"{prefix}upper_deg": high_deg}

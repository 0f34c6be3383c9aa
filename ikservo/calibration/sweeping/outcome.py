"""What a finished conversation means: the calibration to save and what the servos must hold."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import datetime

from ikservo.calibration.filing.record import CalibratedJoint, CalibratedServo, Calibration
from ikservo.calibration.in_servos.memory import ServoFacts, counts_on, wanted_memory
from ikservo.calibration.sweeping.homing import X_MOST, Homing, Travel, choose_homing
from ikservo.calibration.sweeping.measured import Measured, measure
from ikservo.calibration.sweeping.subject import Subject
from ikservo.calibration.sweeping.sweep import Wizard
from ikservo.calibration.ticks.encoder import encoder_of
from ikservo.calibration.ticks.joint_map import JointMap
from ikservo.calibration.ticks.limits import Limits
from ikservo.calibration.ticks.seam import short_way
from ikservo.errors import CalibrationError
from ikservo.registers import Family

__all__ = ["About", "Memory", "Outcome", "conclude"]

_ALIKE_TICKS = 3  # servos of one joint that differ by less are as alike as their gears

Facts = Mapping[int, ServoFacts]
Memory = Mapping[int, Mapping[str, int]]
"""Raw numbers by servo id and register."""


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
    """A calibration, and what each servo must hold for it."""

    calibration: Calibration
    memory: Memory


def conclude(
    wizard: Wizard,
    facts: Facts,
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
    memory: dict[int, Mapping[str, int]] = {}
    joints: list[CalibratedJoint] = []
    for subject in wizard.subjects:
        own = (user or {}).get(subject.name)
        homing, found = _counted(wizard, subject, facts)
        limits = found.limits(subject.expected, wizard.margin_rad, own)
        inside = found.joint_map.ticks_inside(limits.lower.value, limits.upper.value)
        registers = inside if write_limits and not homing.extended else None
        for servo_id, set_up in _homings(wizard, subject, facts, homing, found.travel):
            memory[servo_id] = wanted_memory(facts[servo_id], set_up, registers)
        joints.append(_filed(wizard, subject, found, own, _servos(subject, facts, memory)))
    return Outcome(_calibration(about, wizard.margin_rad, joints), memory)


def _calibration(about: About, margin_rad: float, joints: list[CalibratedJoint]) -> Calibration:
    return Calibration(
        format=1,
        arm=about.arm,
        written=about.written,
        tool_version=about.tool_version,
        usb_serial_number=about.usb_serial_number,
        family=about.family,
        anchor_pose=about.anchor_pose,
        margin_deg=math.degrees(margin_rad),
        joints=tuple(joints),
    )


def _counted(wizard: Wizard, subject: Subject, facts: Facts) -> tuple[Homing, Measured]:
    """Return how the joint's servo must count, and the joint in the ticks it then reports."""
    lead, found = facts[subject.servo_id], measure(wizard, subject)
    homing = choose_homing(
        subject.name,
        lead.table.family,
        found.travel,
        lead.offset,
        encoder_of(lead.table),
        counts_on=lead.counts_on and not subject.shadow_ids,
    )
    if homing.extended and subject.shadow_ids:
        raise CalibrationError(
            f"{subject.name}: its travel crosses the encoder's wrap-around of servo "
            f"{subject.servo_id}; two servos on one joint cannot both use multi-turn mode.",
            "Remount its horns so that the middle of the joint is near tick 2048.",
        )
    return homing, found.shifted(homing.shift)


def _homings(
    wizard: Wizard, subject: Subject, facts: Facts, homing: Homing, travel: Travel
) -> list[tuple[int, Homing]]:
    """Return how each servo of a joint is set up: shadows report what the first one does."""
    rows = [(subject.servo_id, homing)]
    reported = round(wizard.anchor[subject.servo_id] - homing.shift)
    for shadow_id in subject.shadow_ids:
        wanted = short_way(round(wizard.anchor[shadow_id]), reported, subject.turn)
        held = facts[shadow_id].offset
        offset = held if abs(wanted - held) <= _ALIKE_TICKS else wanted
        if abs(offset) > X_MOST or travel.low < offset or travel.high - offset >= subject.turn:
            raise CalibrationError(
                f"Servo {shadow_id} of {subject.name} is {offset} ticks off servo "
                f"{subject.servo_id}; a homing offset corrects at most {X_MOST}.",
                f"Remount the horn of servo {shadow_id} so that both report nearly the same.",
            )
        rows.append((shadow_id, Homing(offset, False, -offset)))
    return rows


def _servos(subject: Subject, facts: Facts, memory: Memory) -> list[CalibratedServo]:
    return [
        CalibratedServo(
            id=servo_id,
            model=facts[servo_id].table.model_name,
            firmware=facts[servo_id].firmware,
            holds=dict(memory[servo_id]),
        )
        for servo_id in (subject.servo_id, *subject.shadow_ids)
    ]


def _filed(
    wizard: Wizard,
    subject: Subject,
    found: Measured,
    user: Limits | None,
    servos: list[CalibratedServo],
) -> CalibratedJoint:
    placed, (lead, *shadows) = found.joint_map, servos
    return CalibratedJoint(
        name=subject.name,
        sign=1 if placed.sign > 0 else -1,
        sign_from="by hand" if subject.name in wizard.signs else "arm file",
        zero_tick=placed.zero_tick,
        gear=placed.gear,
        extended=counts_on(lead.holds),
        swept=found.swept,
        travel_ticks=(found.travel.low, found.travel.high),
        servo=lead,
        shadows=tuple(shadows),
        **_in_file_units("", found.ends(wizard.margin_rad), placed),
        **_in_file_units("user_", user and (user.lower.value, user.upper.value), placed),
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

"""What a calibration file may not say although each value by itself is right."""

from __future__ import annotations

from collections.abc import Iterator

from ikservo.calibration.filing.record import CalibratedJoint, CalibratedServo, Calibration
from ikservo.calibration.in_servos.memory import held_registers
from ikservo.calibration.sweeping.homing import STS_MOST, X_MOST
from ikservo.calibration.sweeping.obstacles import LEAST_TICKS
from ikservo.calibration.ticks.encoder import encoder_of
from ikservo.files.complaints import Complaint, Location
from ikservo.files.quoting import quoted
from ikservo.registers import MODELS, Family

__all__ = ["contradictions"]


def contradictions(calibration: Calibration) -> Iterator[Complaint]:
    """Yield each contradiction between values, in the order of the file."""
    if calibration.written.tzinfo is None:
        yield Complaint(("written",), "has no offset", "a time such as 2026-11-02T14:03:22Z")
    yield from _geometry(calibration)
    yield from _repeated_names(calibration)
    yield from _repeated_ids(calibration)
    for i, joint in enumerate(calibration.joints):
        for servo in joint.servos:
            yield from _servo(("joints", i, "servo"), servo, calibration.family)
        yield from _travel(("joints", i), joint)
        yield from _range(("joints", i), joint)


def _geometry(calibration: Calibration) -> Iterator[Complaint]:
    geometry = calibration.geometry
    if geometry is None:
        return
    if geometry.touched.tzinfo is None:
        expected = "a time such as 2026-11-02T14:03:22Z"
        yield Complaint(("geometry", "touched"), "has no offset", expected)
    names = [origin.joint for origin in geometry.origins]
    for i, name in enumerate(names):
        if name in names[:i]:
            where = ("geometry", "origins", i, "joint")
            yield Complaint(where, f"is {quoted(name)} a second time", "each joint once")


def _repeated_names(calibration: Calibration) -> Iterator[Complaint]:
    seen: set[str] = set()
    for i, joint in enumerate(calibration.joints):
        if joint.name in seen:
            found = f"is {quoted(joint.name)} a second time"
            yield Complaint(("joints", i, "name"), found, "a unique name")
        seen.add(joint.name)


def _repeated_ids(calibration: Calibration) -> Iterator[Complaint]:
    seen: set[int] = set()
    for i, joint in enumerate(calibration.joints):
        for servo in joint.servos:
            if servo.id in seen:
                found = f"is {servo.id} a second time"
                yield Complaint(("joints", i, "servo", "id"), found, "a unique id")
            seen.add(servo.id)


def _servo(where: Location, servo: CalibratedServo, family: str) -> Iterator[Complaint]:
    table = MODELS.get(servo.model)
    if table is None or table.family != family:
        known = ", ".join(name for name, t in MODELS.items() if t.family == family)
        yield Complaint((*where, "model"), f"is {quoted(servo.model)}", f"one of: {known}")
        return
    for name, number in servo.holds.items():
        if name not in table.registers:
            yield Complaint(
                (*where, "holds", name), "is not a register", f"one of {table.model_name}"
            )
        elif not table.registers[name].range[0] <= number <= table.registers[name].range[1]:
            low, high = table.registers[name].range
            yield Complaint((*where, "holds", name), f"is {number}", f"{low} to {high}")
    for register in held_registers(table):
        if register.name not in servo.holds:
            yield Complaint((*where, "holds", register.name), "is missing", "what the servo held")


def _travel(where: Location, joint: CalibratedJoint) -> Iterator[Complaint]:
    table = MODELS.get(joint.servo.model)
    if table is None:
        return
    low, high = joint.travel_ticks
    encoder = encoder_of(table)
    if not LEAST_TICKS <= high - low < encoder.ticks:
        found = f"is [{low}, {high}]"
        yield Complaint(
            (*where, "travel_ticks"), found, f"{LEAST_TICKS} to {encoder.ticks - 1} ticks apart"
        )
    elif not joint.extended and (low < 0 or high >= encoder.ticks):
        found = f"is [{low}, {high}]"
        yield Complaint((*where, "travel_ticks"), found, f"ticks from 0 to {encoder.ticks - 1}")
    yield from _offset(where, joint, table.family)


def _offset(where: Location, joint: CalibratedJoint, family: Family) -> Iterator[Complaint]:
    most = {Family.FEETECH_STS: STS_MOST, Family.DYNAMIXEL_2: X_MOST}.get(family)
    offset = joint.servo.holds.get("homing_offset", 0)
    if most is not None and not joint.extended and abs(offset) > most:
        location = (*where, "servo", "holds", "homing_offset")
        yield Complaint(location, f"is {offset}", f"-{most} to {most}")


def _range(where: Location, joint: CalibratedJoint) -> Iterator[Complaint]:
    swept = joint.swept_range()
    if (swept is None) != (joint.swept == "not swept"):
        yield Complaint((*where, "swept"), f"is {quoted(joint.swept)}", "both limits, or neither")
    elif swept and not swept[0] < swept[1]:
        yield Complaint((*where, "lower_deg"), "is not below the upper limit", "lower < upper")

"""What the arm file says about the servos' EEPROM, compared and written."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

from ikservo.arm.care.findings import Finding, bad, good, odd
from ikservo.arm.own import serial_number_of
from ikservo.calibration.filing.store import load
from ikservo.calibration.in_servos.memory import held_registers
from ikservo.errors import BusError, FileFormatError, UnknownNameError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.keeping.eeprom import Difference, differences, update_eeprom
from ikservo.hardware.packets.notation import Wanted
from ikservo.hardware.servo import ServoSpec
from ikservo.model import Model, ModelServo
from ikservo.registers import Role

__all__ = ["at_once", "check_eeprom", "listed_servos", "wanted_eeprom", "write_eeprom"]

_ITS_OWN = {"homing_offset", "min_position_limit", "max_position_limit"}  # may be this arm's


def check_eeprom(bus: ServoBus, model: Model) -> Iterator[Finding]:
    """Yield where servos hold other numbers than the arm file says.

    Args:
        bus: The line, with the servos that answer.
        model: The arm they should be.
    """
    own_numbers = _calibrated(bus, model)
    compared, alike = 0, True
    for own in listed_servos(model):
        if own.id not in bus.servos or not own.eeprom:
            continue
        compared += len(own.eeprom)
        for finding in _differing(bus, own, own_numbers):
            alike = False
            yield finding
    if compared and alike:
        yield good("eeprom", f"{compared} values match the arm file")


def _differing(bus: ServoBus, own: ModelServo, own_numbers: bool) -> Iterator[Finding]:
    servo = bus.servos[own.id]
    try:
        left = differences(bus, own.id, _wanted(servo, own, own_numbers))
    except (BusError, UnknownNameError) as error:
        yield bad("eeprom", f"{servo}: {error.message}", error.command_hint)
        return
    for one in left:
        kind = odd if one.register.name in _ITS_OWN else bad
        yield kind(
            "eeprom",
            f"{servo}: {one.register} is {one.found}, {one.wanted} in the arm file",
            "Write the values of the arm file: ikservo doctor --write-eeprom",
        )


def _calibrated(bus: ServoBus, model: Model) -> bool:
    """Return whether some of the servos' numbers are this very arm's and not the arm file's."""
    try:
        return load(model.name, serial_number_of(bus.port.name)) is not None
    except FileFormatError:
        return True  # a spoiled calibration is still one


def _wanted(servo: ServoSpec, own: ModelServo, own_numbers: bool) -> dict[Wanted, int]:
    """Return what the arm file says, but for what a calibration of this arm rests on."""
    wanted = wanted_eeprom(servo, own.eeprom)
    kept = held_registers(servo.table) if own_numbers else ()
    return {register: number for register, number in wanted.items() if register not in kept}


def listed_servos(model: Model) -> list[ModelServo]:
    """Return every servo of the arm file, shadows behind the servo they follow."""
    return [servo for joint in model.joints for servo in (joint.servo, *joint.shadows)]


def wanted_eeprom(servo: ServoSpec, values: Mapping[str, int]) -> dict[Wanted, int]:
    """Return the arm file's raw values by the servo's own registers.

    Raises:
        UnknownNameError: The servo has no such register.
    """
    registers = servo.table.registers
    unknown = [name for name in values if name not in registers]
    if unknown:
        raise UnknownNameError(f"{servo.table.model_name} register", unknown[0], registers)
    return {registers[name]: number for name, number in values.items()}


def write_eeprom(bus: ServoBus, model: Model) -> dict[ServoSpec, list[Difference]]:
    """Make every servo hold what the arm file says, and answer at once; return what changed.

    What a calibration of this arm rests on is left alone: the calibration says what belongs there.

    Raises:
        RegisterAccessError: Torque is on, or a register forbids its number; servos before it
            are written.
        ServoRefusedError: A number did not last.
        BusError: A servo does not answer.
    """
    changed: dict[ServoSpec, list[Difference]] = {}
    own_numbers = _calibrated(bus, model)
    for own in listed_servos(model):
        servo = bus.servos[own.id]
        changes = update_eeprom(bus, own.id, at_once(servo) | _wanted(servo, own, own_numbers))
        if changes:
            changed[servo] = changes
    return changed


def at_once(servo: ServoSpec) -> dict[Wanted, int]:
    """Return the return delay as it should be, where the servo has one."""
    has_delay = Role.RETURN_DELAY not in servo.table.lacks
    return {servo.table.return_delay: 0} if has_delay else {}

"""Restore the EEPROM of a servo from its backup."""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.errors import CalibrationError, InputError, RegisterAccessError, UnknownNameError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.eeprom import (
    Backup,
    RegisterDifference,
    refuse_under_torque,
    register_differences,
    update_eeprom,
)
from ikservo.hardware.register_batches import RegisterRef
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import Access, ControlTable, Register, RegisterName

_PROTOCOL = "protocol_type"  # with another protocol the servo would not reply on this bus


@dataclass(frozen=True, slots=True)
class Restoration:
    """The writes that restore a servo from its backup.

    Attributes:
        servo: The servo.
        backup: The backup.
        changes: The registers that differ and will be written.
        kept: The registers that differ but are not written: id, baud rate, protocol, read-only
            registers, and values that another model does not accept.
    """

    servo: ServoSpec
    backup: Backup
    changes: tuple[RegisterDifference, ...]
    kept: tuple[RegisterDifference, ...]


def plan_restoration(
    bus: ServoBus, backup: Backup, target: str | None = None, *, other_model: bool = False
) -> Restoration:
    """Compare a servo with a backup; nothing is written.

    ``target`` is the joint or the id of the servo to write; by default, the id of the backup.

    Raises:
        InputError: The backup is from another servo or model, which was not allowed.
        CalibrationError: The connected servo is a different model from the model in the arm file.
        RegisterAccessError: Torque is on, or the servo does not accept a value.
        BusError: The servo does not answer.
    """
    servo = _find_servo(bus, backup, target)
    number = bus.read(servo.id, RegisterName.MODEL_NUMBER, raw=True)
    if number != servo.table.number:
        raise CalibrationError(
            f"{servo} must be a {servo.table.model_name}, but reports model {number}.",
            "Check the ids of the servos: ikservo doctor. Nothing was written.",
        )
    if backup.table is not servo.table and not other_model:
        raise InputError(
            f"{backup.path} is a backup of a {backup.table.model_name}; "
            f"{servo} is a {servo.table.model_name}.",
            "Choose the backup of this servo, or add --other-model.",
        )
    registers = servo.table.registers
    common: dict[RegisterRef, int] = {
        registers[name]: raw for name, raw in backup.eeprom.items() if name in registers
    }
    found = register_differences(bus, servo.id, common)
    changes = tuple(
        each for each in found if _is_restorable(servo.table, each, strict=not other_model)
    )
    if changes:
        refuse_under_torque(bus, servo.id, changes[0].register)
    for each in changes:
        if not _accepts(each.register, each.expected):
            lower, upper = each.register.range
            reason = f"{each.expected} is outside {lower} to {upper}"
            raise RegisterAccessError(str(servo), each.register.name, reason)
    return Restoration(servo, backup, changes, tuple(each for each in found if each not in changes))


def write_restoration(bus: ServoBus, restoration: Restoration) -> list[RegisterDifference]:
    """Write the changes, verify them and lock the EEPROM; return them.

    Raises:
        RegisterAccessError: Torque is on.
        ServoRejectedError: A value was not kept.
        BusError: The servo does not answer.
    """
    values: dict[RegisterRef, int] = {each.register: each.expected for each in restoration.changes}
    return update_eeprom(bus, restoration.servo.id, values) if values else []


def _find_servo(bus: ServoBus, backup: Backup, target: str | None) -> ServoSpec:
    servos = list(bus.servos.values())
    if target is not None:
        found = [each for each in servos if target in (each.name, str(each.id))]
        if not found:
            raise UnknownNameError("servo", target, [each.name for each in servos])
        if len(found) > 1:
            ids = " or ".join(str(each.id) for each in found)
            raise InputError(f"{target} has several servos.", f"Give the id: {ids}.")
        return found[0]
    if backup.servo_id not in bus.servos:
        raise InputError(
            f"{backup.path} is a backup of the servo with id {backup.servo_id}, "
            "which the arm does not have.",
            "Give the servo for this backup: --servo JOINT.",
        )
    return bus.servos[backup.servo_id]


def _is_restorable(table: type[ControlTable], change: RegisterDifference, *, strict: bool) -> bool:
    register = change.register
    fixed = register in (table.id, table.baud_rate) or register.name == _PROTOCOL
    if fixed or register.access is Access.RO:
        return False
    return strict or _accepts(register, change.expected)


def _accepts(register: Register, number: int) -> bool:
    lower, upper = register.range
    return lower <= number <= upper

"""What survives loss of power: written only where it differs, verified, and locked again."""

from __future__ import annotations

import contextlib
from collections.abc import Generator, Mapping
from dataclasses import dataclass

from ikservo.errors import RegisterAccessError, ServoRefusedError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.packets.notation import Wanted, own_register
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import Area, Register, Role, ServoTable

__all__ = [
    "Difference",
    "differences",
    "eeprom_registers",
    "read_eeprom",
    "refuse_under_torque",
    "update_eeprom",
]


@dataclass(frozen=True, slots=True)
class Difference:
    """A register that does not hold what it should.

    Attributes:
        register: Which.
        found: The raw number it holds.
        wanted: The raw number it should hold.
    """

    register: Register
    found: int
    wanted: int


def eeprom_registers(table: type[ServoTable]) -> list[Register]:
    """Return the registers of a model that survive loss of power."""
    return [r for r in table.registers.values() if r.area is Area.EEPROM]


def read_eeprom(bus: ServoBus, servo_id: int) -> dict[str, int]:
    """Return every EEPROM register of a servo by name, raw: a backup.

    Raises:
        BusError: The servo does not answer.
    """
    rows = eeprom_registers(bus.servos[servo_id].table)
    readings = bus.sync_read_many([servo_id], rows, raw=True).complete()[servo_id]
    return {register.name: readings[register] for register in rows}


def differences(bus: ServoBus, servo_id: int, wanted: Mapping[Wanted, int]) -> list[Difference]:
    """Return the registers that do not hold the wanted raw numbers.

    Raises:
        BusError: The servo does not answer.
    """
    servo = bus.servos[servo_id]
    rows = {own_register(servo, key): number for key, number in wanted.items()}
    found = bus.sync_read_many([servo_id], list(rows), raw=True).complete()[servo_id]
    return [Difference(r, found[r], number) for r, number in rows.items() if found[r] != number]


def update_eeprom(bus: ServoBus, servo_id: int, wanted: Mapping[Wanted, int]) -> list[Difference]:
    """Make EEPROM registers hold raw numbers, and return what had to be changed.

    Nothing is written where everything holds already, for EEPROM wears out. Afterwards every
    number is read back and the memory is locked, also after a failure, and where an earlier run
    died just before it would have locked it.

    Raises:
        RegisterAccessError: A register is no EEPROM, forbids its number, or torque is on.
        ServoRefusedError: A number did not last.
        BusError: The servo does not answer.
    """
    servo = bus.servos[servo_id]
    for key in wanted:
        _refuse_foreign(servo, own_register(servo, key))
    changes = differences(bus, servo_id, wanted)
    if changes:
        refuse_under_torque(bus, servo_id, changes[0].register)
        with _unlocked(bus, servo_id):
            for change in changes:
                bus.write(servo_id, change.register, change.wanted, raw=True)
            _verify(bus, servo_id, wanted)
    else:
        _lock_if_open(bus, servo_id)
    return changes


def _refuse_foreign(servo: ServoSpec, register: Register) -> None:
    if register.area is not Area.EEPROM:
        raise RegisterAccessError(str(servo), register.name, "it is not in EEPROM")
    if register in (servo.table.id, servo.table.baud_rate):
        reason = "the servo would no longer answer on this bus"
        raise RegisterAccessError(str(servo), register.name, reason, "Use: ikservo setup")


def refuse_under_torque(bus: ServoBus, servo_id: int, register: Register) -> None:
    """Check that an EEPROM register can be written.

    Raises:
        RegisterAccessError: Torque is on.
        BusError: The servo does not answer.
    """
    if bus.read(servo_id, Role.TORQUE_ENABLE, raw=True):
        raise RegisterAccessError(
            str(bus.servos[servo_id]),
            register.name,
            "it is in EEPROM and torque is on",
            "Switch torque off.",
        )


@contextlib.contextmanager
def _unlocked(bus: ServoBus, servo_id: int) -> Generator[None]:
    lock = bus.servos[servo_id].table.eeprom_lock
    if lock is None:
        yield
        return
    bus.write(servo_id, lock, 0, raw=True)
    try:
        yield
    finally:
        bus.write(servo_id, lock, 1, raw=True)


def _lock_if_open(bus: ServoBus, servo_id: int) -> None:
    lock = bus.servos[servo_id].table.eeprom_lock
    if lock is not None and bus.read(servo_id, lock, raw=True) == 0:
        bus.write(servo_id, lock, 1, raw=True)


def _verify(bus: ServoBus, servo_id: int, wanted: Mapping[Wanted, int]) -> None:
    for left in differences(bus, servo_id, wanted):
        raise ServoRefusedError(
            f"holds {left.register} = {left.found} after {left.wanted} was written",
            "Its EEPROM may be worn out or locked.",
            servo=str(bus.servos[servo_id]),
            servo_id=servo_id,
            port=bus.port.name,
        )

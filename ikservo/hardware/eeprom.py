"""Read, compare and write the EEPROM of servos, and the backup files with its values.

``backups/<owner>/id_003_STS3215.toml`` in the user's configuration folder::

    format = 1
    model = "STS3215"
    id = 3

    [eeprom]
    homing_offset = -100

The first copy is never overwritten, because it holds the servo's values before any change by
ikservo.
"""

from __future__ import annotations

import contextlib
import re
from collections.abc import Generator, Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from ikservo.errors import FileFormatError, RegisterAccessError, ServoRejectedError, shown
from ikservo.files.reading import MAX_BYTES, config_dir, parse_toml, read_text
from ikservo.files.writing import write_atomic
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.register_batches import RegisterRef, resolve_register
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import MODELS, Area, ControlTable, Register, RegisterName


@dataclass(frozen=True, slots=True)
class RegisterDifference:
    """A register whose raw number differs from the expected number."""

    register: Register
    found: int
    expected: int

    def __str__(self) -> str:
        return f"{self.register} {self.found} → {self.expected}"


def eeprom_registers(table: type[ControlTable]) -> list[Register]:
    """Return the registers of a model that survive loss of power."""
    return [r for r in table.registers.values() if r.area is Area.EEPROM]


def read_eeprom(bus: ServoBus, servo_id: int) -> dict[str, int]:
    """Read the raw number of every EEPROM register of a servo, by name.

    Raises:
        BusError: The servo does not reply.
    """
    rows = eeprom_registers(bus.servos[servo_id].table)
    readings = bus.sync_read_many([servo_id], rows, raw=True).require_all()[servo_id]
    return {register.name: readings[register] for register in rows}


def register_differences(
    bus: ServoBus, servo_id: int, expected: Mapping[RegisterRef, int]
) -> list[RegisterDifference]:
    """Return the registers whose raw numbers differ from the expected numbers.

    Raises:
        BusError: The servo does not reply.
    """
    servo = bus.servos[servo_id]
    rows = {resolve_register(servo, key): number for key, number in expected.items()}
    found = bus.sync_read_many([servo_id], list(rows), raw=True).require_all()[servo_id]
    return [
        RegisterDifference(r, found[r], number) for r, number in rows.items() if found[r] != number
    ]


def update_eeprom(
    bus: ServoBus, servo_id: int, expected: Mapping[RegisterRef, int]
) -> list[RegisterDifference]:
    """Write the EEPROM registers that differ from given raw numbers; return the changes.

    Nothing is written if all are equal already, because EEPROM wears out. Afterwards every number
    is read back. The EEPROM is locked at the end, even after a failure, and even if an earlier run
    was killed while it was unlocked. A backup is made before the first change.

    Raises:
        RegisterAccessError: A register is not in EEPROM, forbids its number, or torque is on.
        ServoRejectedError: A number was not stored.
        BusError: The servo does not reply.
        FileWriteError: The backup cannot be written; nothing was changed.
    """
    servo = bus.servos[servo_id]
    for key in expected:
        register = resolve_register(servo, key)
        if register.area is not Area.EEPROM:
            raise RegisterAccessError(str(servo), register.name, "it is not in EEPROM")
        if register in (servo.table.id, servo.table.baud_rate):
            reason = "the servo would no longer answer on this bus"
            raise RegisterAccessError(str(servo), register.name, reason, "Use: ikservo setup")
    changes = register_differences(bus, servo_id, expected)
    if changes:
        refuse_under_torque(bus, servo_id, changes[0].register)
        back_up_once(bus, bus.backup_owner, [servo_id])
        with _unlocked_eeprom(bus, servo_id):
            for change in changes:
                bus.write(servo_id, change.register, change.expected, raw=True)
            for wrong in register_differences(bus, servo_id, expected):
                raise ServoRejectedError(
                    f"holds {wrong.register} = {wrong.found} after {wrong.expected} was written",
                    "Its EEPROM may be worn out or locked.",
                    servo=str(servo),
                    servo_id=servo_id,
                    port=bus.port.name,
                )
    else:
        lock_eeprom(bus, servo_id)
    return changes


def refuse_under_torque(bus: ServoBus, servo_id: int, register: Register) -> None:
    """Refuse to write an EEPROM register while torque is on.

    Raises:
        RegisterAccessError: Torque is on.
        BusError: The servo does not reply.
    """
    if bus.read(servo_id, RegisterName.TORQUE_ENABLE, raw=True):
        reason = "it is in EEPROM and torque is on"
        raise RegisterAccessError(
            str(bus.servos[servo_id]), register.name, reason, "Switch torque off."
        )


@contextlib.contextmanager
def _unlocked_eeprom(bus: ServoBus, servo_id: int) -> Generator[None]:
    lock = bus.servos[servo_id].table.eeprom_lock
    if lock is None:
        yield
        return
    bus.write(servo_id, lock, 0, raw=True)
    try:
        yield
    finally:
        bus.write(servo_id, lock, 1, raw=True)


def lock_eeprom(bus: ServoBus, servo_id: int) -> None:
    """Lock a servo's EEPROM if a killed program has left it unlocked.

    Raises:
        BusError: The servo does not reply.
    """
    lock = bus.servos[servo_id].table.eeprom_lock
    if lock is not None and bus.read(servo_id, lock, raw=True) == 0:
        bus.write(servo_id, lock, 1, raw=True)


_FORMAT = 1
_HIGHEST_ID = 253


@dataclass(frozen=True, slots=True)
class Backup:
    """A copy of a servo's EEPROM.

    Attributes:
        path: The file.
        table: The servo model.
        servo_id: The servo's id after the operation for which the copy was made.
        eeprom: The raw number of every EEPROM register by name.
    """

    path: Path
    table: type[ControlTable]
    servo_id: int
    eeprom: Mapping[str, int]


def backup_path(owner: str, servo: ServoSpec) -> Path:
    """Return the file of a servo's first EEPROM copy; the owner is an arm or an adapter's number.

    Another model with the same id has a separate file.
    """
    folder = re.sub(r"[^A-Za-z0-9_-]", "_", owner) or "_"
    return config_dir() / "backups" / folder / f"id_{servo.id:03}_{servo.table.model_name}.toml"


def back_up_once(bus: ServoBus, owner: str, servo_ids: Iterable[int] | None = None) -> list[Path]:
    """Write a copy of the EEPROM of each servo without a copy; return the new files.

    The owner is the arm's name or the serial number of the adapter; if empty, nothing is copied.

    Raises:
        BusError: A servo does not reply; the servos before it have been copied.
        FileWriteError: A file cannot be written.
    """
    written: list[Path] = []
    for servo_id in bus.servos if servo_ids is None else servo_ids:
        path = backup_path(owner, bus.servos[servo_id])
        if owner and not path.exists():
            write_backup(bus, servo_id, path)
            written.append(path)
    return written


def write_backup(bus: ServoBus, servo_id: int, path: Path) -> None:
    """Write a copy of a servo's EEPROM; an existing file is replaced.

    Raises:
        BusError: The servo does not reply; nothing was written.
        FileWriteError: The file cannot be written.
    """
    write_atomic(path, backup_text(bus, servo_id))


def backup_text(bus: ServoBus, servo_id: int, new_id: int | None = None) -> str:
    """Return the text of a backup file of a servo's EEPROM, with ``new_id`` as its id if given.

    Raises:
        BusError: The servo does not reply.
    """
    servo, eeprom = bus.servos[servo_id], read_eeprom(bus, servo_id)
    lines = [
        f"format = {_FORMAT}",
        f'model = "{servo.table.model_name}"',
        f"id = {servo.id if new_id is None else new_id}",
        "",
        "[eeprom]",
        *(f"{name} = {number}" for name, number in eeprom.items()),
    ]
    return "\n".join(lines) + "\n"


def read_backup(path: Path) -> Backup:
    """Read a backup file.

    Raises:
        FileFormatError: The file is not a backup, or is damaged.
    """
    return parse_backup(path, read_text(path, MAX_BYTES))


def parse_backup(path: Path, text: str) -> Backup:
    """Parse the text of a backup file; the path is only for messages.

    Raises:
        FileFormatError: The text is not a backup, or is damaged.
    """
    tables = parse_toml(path, text)
    model, servo_id = tables.get("model"), tables.get("id")
    rows: object = tables.get("eeprom")
    if tables.get("format") != _FORMAT or not isinstance(rows, dict):
        raise FileFormatError(path, "", "is not an EEPROM backup of a servo", f"format = {_FORMAT}")
    if not isinstance(model, str) or model not in MODELS:
        raise FileFormatError(path, "model", f"is {shown(model)}", f"one of {', '.join(MODELS)}")
    if type(servo_id) is not int or not 0 <= servo_id <= _HIGHEST_ID:
        raise FileFormatError(path, "id", f"is {shown(servo_id)}", f"an id from 0 to {_HIGHEST_ID}")
    eeprom = _check_eeprom(path, MODELS[model], cast("dict[str, object]", rows))
    return Backup(path, MODELS[model], servo_id, eeprom)


def _check_eeprom(
    path: Path, table: type[ControlTable], rows: Mapping[str, object]
) -> dict[str, int]:
    """Return the numbers in a backup, which must cover the model's whole EEPROM."""
    registers = eeprom_registers(table)
    names = {register.name for register in registers}
    for name in rows.keys() - names:
        found = f"is not an EEPROM register of {table.model_name}"
        raise FileFormatError(path, f"eeprom.{name}", found)
    for register in registers:
        if register.name not in rows:
            raise FileFormatError(path, "eeprom", f"lacks {register}", "every EEPROM register")
    eeprom: dict[str, int] = {}
    for register in registers:
        number = rows[register.name]
        lower, upper = register.codec.span(register.size)  # some registers cannot be written
        if type(number) is not int or not lower <= number <= upper:
            where = f"eeprom.{register}"
            raise FileFormatError(
                path, where, f"is {shown(number)}", "a number that fits the register"
            )
        eeprom[register.name] = number
    return eeprom


def firmware_version(bus: ServoBus, servo_id: int) -> str:
    """Return a servo's firmware version in the vendor's notation.

    Raises:
        BusError: The servo does not reply.
    """
    registers = bus.servos[servo_id].table.registers
    names = [name for name in _FIRMWARE if name in registers]
    return ".".join(f"{bus.read(servo_id, registers[name], raw=True)}" for name in names)


_FIRMWARE = ("firmware_major", "firmware_minor", "firmware_version")

"""A copy of each servo's EEPROM, kept from the day it was first met.

``backups/<owner>/id_003_STS3215.toml`` in the user's configuration folder::

    format = 1
    model = "STS3215"
    id = 3

    [eeprom]
    homing_offset = -100

The first copy is never overwritten: it holds what the servo was before anybody changed it.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import cast

from ikservo.errors import FileFormatError
from ikservo.files.reading import read_text
from ikservo.files.toml import LARGEST_BYTES, parse_toml
from ikservo.files.writing import write_whole
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.keeping.eeprom import eeprom_registers, read_eeprom
from ikservo.hardware.line.remembered import config_folder
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import MODELS, Register, ServoTable

__all__ = ["Backup", "back_up_once", "backup_path", "read_backup"]

_FORMAT = 1
_HIGHEST_ID = 253


@dataclass(frozen=True, slots=True)
class Backup:
    """A copy of a servo's EEPROM.

    Attributes:
        path: The file.
        table: The model that it was made of.
        servo_id: The id that it had.
        eeprom: The raw number of every EEPROM register by name.
    """

    path: Path
    table: type[ServoTable]
    servo_id: int
    eeprom: Mapping[str, int]


def backup_path(owner: str, servo: ServoSpec) -> Path:
    """Return the file of a servo's first EEPROM copy.

    Args:
        owner: The arm's name, or the serial number of the adapter.
        servo: Which servo; another model at the same id has a file of its own.
    """
    folder = re.sub(r"[^A-Za-z0-9_-]", "_", owner) or "_"
    return config_folder() / "backups" / folder / f"id_{servo.id:03}_{servo.table.model_name}.toml"


def back_up_once(bus: ServoBus, owner: str, servo_ids: Iterable[int] | None = None) -> list[Path]:
    """Write a copy of the EEPROM of each servo that has none yet; return the new files.

    Args:
        bus: The line.
        owner: The arm's name, or the serial number of the adapter.
        servo_ids: Whom; all of the line if None.

    Raises:
        BusError: A servo does not answer; those before it have their copies.
        FileWriteError: A file cannot be written.
    """
    made: list[Path] = []
    for servo_id in bus.servos if servo_ids is None else servo_ids:
        path = backup_path(owner, bus.servos[servo_id])
        if not path.exists():
            write_whole(path, _text(bus.servos[servo_id], read_eeprom(bus, servo_id)))
            made.append(path)
    return made


def read_backup(path: Path) -> Backup:
    """Return what stands in a copy.

    Raises:
        FileFormatError: It is no such file, or damaged.
    """
    tables = parse_toml(path, read_text(path, LARGEST_BYTES))
    model, servo_id = tables.get("model"), tables.get("id")
    rows: object = tables.get("eeprom")
    if tables.get("format") != _FORMAT or not isinstance(rows, dict):
        raise FileFormatError(path, "", "is not an EEPROM backup of a servo", f"format = {_FORMAT}")
    if not isinstance(model, str) or model not in MODELS:
        raise FileFormatError(path, "model", f"is {model!r}", f"one of {', '.join(MODELS)}")
    if type(servo_id) is not int or not 0 <= servo_id <= _HIGHEST_ID:
        raise FileFormatError(path, "id", f"is {servo_id!r}", f"an integer from 0 to {_HIGHEST_ID}")
    return Backup(
        path,
        MODELS[model],
        servo_id,
        _checked(path, MODELS[model], cast("dict[str, object]", rows)),
    )


def _checked(path: Path, table: type[ServoTable], rows: Mapping[str, object]) -> dict[str, int]:
    """Return the numbers of a copy, which must be those of the model's whole EEPROM."""
    registers = eeprom_registers(table)
    names = {register.name for register in registers}
    for name in rows.keys() - names:
        found = f"is no EEPROM register of {table.model_name}"
        raise FileFormatError(path, f"eeprom.{name}", found)
    for register in registers:
        if register.name not in rows:
            raise FileFormatError(path, "eeprom", f"lacks {register}", "every EEPROM register")
    eeprom: dict[str, int] = {}
    for register in registers:
        number = rows[register.name]
        if type(number) is not int or not _fits(register, number):
            where = f"eeprom.{register}"
            raise FileFormatError(path, where, f"is {number!r}", "a number that the register holds")
        eeprom[register.name] = number
    return eeprom


def _fits(register: Register, number: int) -> bool:
    """Return whether a register can hold a number; servos may hold more than may be written."""
    least, most = register.codec.span(register.size)
    return least <= number <= most


def _text(servo: ServoSpec, eeprom: Mapping[str, int]) -> str:
    lines = [
        f"format = {_FORMAT}",
        f'model = "{servo.table.model_name}"',
        f"id = {servo.id}",
        "",
        "[eeprom]",
        *(f"{name} = {number}" for name, number in eeprom.items()),
    ]
    return "\n".join(lines) + "\n"

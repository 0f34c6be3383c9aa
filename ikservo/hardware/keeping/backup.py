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
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, cast

from ikservo.errors import FileFormatError
from ikservo.files.writing import write_whole
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.keeping.eeprom import read_eeprom
from ikservo.hardware.line.remembered import config_folder
from ikservo.hardware.servo import ServoSpec

__all__ = ["back_up_once", "backup_path", "read_backup"]

_FORMAT = 1


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


def read_backup(path: Path) -> dict[str, int]:
    """Return the raw numbers of a copy by register name.

    Raises:
        FileFormatError: It is no such file.
    """
    try:
        tables: dict[str, Any] = tomllib.loads(path.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise FileFormatError(path, "", f"cannot be read ({error})") from error
    eeprom: object = tables.get("eeprom")
    if tables.get("format") != _FORMAT or not isinstance(eeprom, dict):
        raise FileFormatError(path, "", "is not an EEPROM backup of a servo", f"format = {_FORMAT}")
    rows = cast("dict[str, object]", eeprom)
    for name, number in rows.items():
        if type(number) is not int:
            raise FileFormatError(path, f"eeprom.{name}", f"is {number!r}", "an integer")
    return cast("dict[str, int]", rows)


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

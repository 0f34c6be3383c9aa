"""Keep a servo's former values on disk while other values are tried, until they are restored.

A program that is killed during a trial leaves the trial values in the servo until its power
goes off; the file holds the former values.
"""

from __future__ import annotations

import contextlib
import json
from collections.abc import Container, Mapping
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from ikservo.errors import FileFormatError
from ikservo.files.reading import config_dir, read_text
from ikservo.files.writing import remove_durably, write_atomic
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.eeprom import RegisterDifference, register_differences
from ikservo.hardware.port_choice import is_simulator
from ikservo.hardware.port_names import serial_number_of
from ikservo.hardware.servo import ServoSpec
from ikservo.registers import Register

_FORMER: TypeAdapter[dict[str, int]] = TypeAdapter(dict[str, int])
_MOST_BYTES = 10_000


def note_former(bus: ServoBus, servo: ServoSpec, former: Mapping[Register, int]) -> None:
    """Write the present values of a real servo to a file before other values are tried.

    Raises:
        FileWriteError: The file cannot be written.
    """
    if not is_simulator(bus.port.name):
        text = json.dumps({register.name: raw for register, raw in former.items()})
        write_atomic(_path(bus, servo), f"{text}\n")


def forget_former(bus: ServoBus, servo: ServoSpec) -> None:
    """Remove the file, because the servo keeps its present values."""
    if (path := _path(bus, servo)).exists():
        remove_durably(path)


def forget_if_former(bus: ServoBus, servo: ServoSpec, registers: Container[Register]) -> None:
    """Remove the file if it has any of the registers; keep a damaged file."""
    with contextlib.suppress(FileFormatError):
        if any(register in registers for register in read_former(bus, servo)):
            forget_former(bus, servo)


def read_former(bus: ServoBus, servo: ServoSpec) -> dict[Register, int]:
    """Return the values from before an interrupted trial; empty if no trial was interrupted.

    Raises:
        FileFormatError: The file is damaged.
    """
    path = _path(bus, servo)
    if not path.exists():
        return {}
    try:
        former = _FORMER.validate_python(json.loads(read_text(path, _MOST_BYTES)), strict=True)
        return {servo.table.registers[name]: raw for name, raw in former.items()}
    except (ValidationError, ValueError, KeyError, RecursionError) as error:
        way_out = "register values; rename the file, then switch the servo's power off and on"
        raise FileFormatError(path, "", "is damaged", way_out) from error


def tried_differences(bus: ServoBus, servo: ServoSpec) -> list[RegisterDifference]:
    """Return the trial values that an interrupted trial has left in a servo.

    Raises:
        FileFormatError: The file is damaged.
        BusError: The servo does not reply.
    """
    former = read_former(bus, servo)
    return register_differences(bus, servo.id, {**former}) if former else []


def restore_former(bus: ServoBus, servo: ServoSpec) -> list[RegisterDifference]:
    """Write the values from before an interrupted trial, and return the changes.

    Raises:
        FileFormatError: The file is damaged.
        BusError: The servo does not reply.
    """
    changes = tried_differences(bus, servo)
    for each in changes:
        bus.write_until_power_off(servo.id, each.register, each.expected)
    forget_former(bus, servo)
    return changes


def _path(bus: ServoBus, servo: ServoSpec) -> Path:
    owner = serial_number_of(bus.port.name) or "servos"
    return config_dir() / "tried" / f"{owner}_{servo.id:03}_{servo.table.model_name}.json"

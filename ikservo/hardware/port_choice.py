"""List and choose serial ports."""

from __future__ import annotations

import os
from pathlib import Path

from ikservo.errors import InputError, NoPortError
from ikservo.hardware.port_names import remember_serial_number, remembered_serial_number
from ikservo.hardware.serial_ports import find_adapter, list_adapters

_VARIABLE = "IKSERVO_PORT"
_SIMULATED = "sim"


def list_ports() -> list[str]:
    """Return the device names of the serial ports that are USB adapters."""
    return [adapter.device for adapter in list_adapters()]


def named_port(name: str | None) -> str:
    """Return the port that the user named, here or in ``IKSERVO_PORT``; empty if there is none."""
    return name or os.environ.get(_VARIABLE, "")


def choose_port(name: str | None, arm: str = "") -> str:
    """Choose the port to use, and return it.

    The candidates, in this order, are: the named port; ``IKSERVO_PORT``; the adapter on which this
    arm was last found, known by its USB serial number; the only port, if there is only one.

    Raises:
        NoPortError: There is no port, or there are several ports to choose from.
    """
    named = named_port(name)
    if named:
        return named
    found = list_adapters()
    serial_number = remembered_serial_number(arm) if arm else ""
    own = [a for a in found if serial_number and a.serial_number == serial_number]
    if own or len(found) == 1:
        return (own or found)[0].device
    why = "several adapters are plugged in" if found else ""
    raise NoPortError("", [adapter.device for adapter in found], why)


def remember_port(arm: str, port: str) -> None:
    """Remember the adapter on which an arm replied, if it has a serial number."""
    adapter = find_adapter(port)
    if adapter is not None:
        remember_serial_number(arm, adapter.serial_number)


def is_simulator(name: str) -> bool:
    """Check whether a port's name means a simulated arm."""
    return name.partition(":")[0] == _SIMULATED


def simulated_port_url(name: str, arm_file: Path | None) -> str:
    """Return the simulator's URL for the arm; options as in ``sim:?seed=3`` are passed on.

    Raises:
        InputError: A bus is to be simulated, but no arm is named, or the options are invalid.
    """
    place, _, options = name.partition(":")[2].partition("?")
    if not is_simulator(name) or (place.startswith("/") and place != str(arm_file)):
        return name
    if arm_file is None:
        raise InputError("No arm given for the simulator.", "Give --arm, as in --arm so101.")
    if place and not place.startswith("/"):
        hint = "Use --port sim or --port sim:?seed=3, and name the arm with --arm."
        raise InputError(f"{name!r} is not a port.", hint)
    return f"{_SIMULATED}:{arm_file.resolve()}{'?' if options else ''}{options}"

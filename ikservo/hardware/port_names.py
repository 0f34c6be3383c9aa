"""Remember which USB adapter belongs to an arm, and reopen it after it was unplugged.

``ports.toml`` in the user's configuration folder::

    format = 1

    [serial_numbers]
    so101 = "58FA0834561"
"""

from __future__ import annotations

import contextlib
import json
from typing import cast

from ikservo.clock import Clock, RealClock
from ikservo.errors import FileFormatError, PortError, PortLostError
from ikservo.files.reading import config_dir, read_toml
from ikservo.files.writing import exclusive_access, write_atomic
from ikservo.hardware.port import Port
from ikservo.hardware.serial_ports import find_adapter, list_adapters
from ikservo.hardware.transport import open_transport

_FILE = "ports.toml"
_FORMAT = 1


def remembered_serial_number(arm: str) -> str:
    """Return the serial number of the adapter on which an arm was last found; empty if unknown."""
    return _read_serial_numbers().get(arm, "")


def remember_serial_number(arm: str, serial_number: str) -> None:
    """Remember an arm's adapter, unless the folder cannot be written."""
    if not serial_number or remembered_serial_number(arm) == serial_number:
        return
    path = config_dir() / _FILE
    with contextlib.suppress(OSError), exclusive_access(path):  # a convenience must not stop an arm
        known = {**_read_serial_numbers(), arm: serial_number}
        rows = [f"{json.dumps(key)} = {json.dumps(each)}" for key, each in sorted(known.items())]
        write_atomic(path, "\n".join([f"format = {_FORMAT}", "", "[serial_numbers]", *rows, ""]))


def _read_serial_numbers() -> dict[str, str]:
    try:
        tables = read_toml(config_dir() / _FILE)
    except FileFormatError:  # missing or damaged: start empty
        return {}
    found = tables.get("serial_numbers")
    if tables.get("format") != _FORMAT or not isinstance(found, dict):
        return {}
    rows = cast("dict[str, object]", found)
    return {arm: number for arm, number in rows.items() if isinstance(number, str)}


_POLL_PERIOD_S = 0.1
_SIMULATED = "sim"


def is_simulated(port_name: str) -> bool:
    """Check whether a port is a simulated bus in this process, which each opening creates anew."""
    return port_name.partition(":")[0] == _SIMULATED


def serial_number_of(name: str) -> str:
    """Return the USB serial number of the adapter behind a port's name; empty if it has none.

    Call this while the adapter is plugged in, so that the adapter is recognised when it comes back.
    The simulated bus uses its name.
    """
    if is_simulated(name):
        return _SIMULATED
    adapter = find_adapter(name)
    return adapter.serial_number if adapter else ""


def reconnect(port: Port, serial_number: str, within_s: float, clock: Clock | None = None) -> None:
    """Open a lost port again as soon as its adapter is back; nothing is sent, nothing moves.

    An adapter without a serial number is only reopened under its old name.

    Raises:
        PortLostError: The adapter did not come back in time.
    """
    clock = clock or RealClock()
    give_up_s = clock.now_s() + within_s
    port.disconnect()
    while not _try_reopen(port, serial_number):
        if clock.now_s() >= give_up_s:
            raise PortLostError(port.name, f"not reconnected within {within_s:.0f} s")
        clock.sleep_until(min(clock.now_s() + _POLL_PERIOD_S, give_up_s))


def _try_reopen(port: Port, serial_number: str) -> bool:
    names = [
        a.device for a in list_adapters() if serial_number and a.serial_number == serial_number
    ]
    for name in names or ([] if serial_number else [port.name]):
        try:
            port.connect(open_transport(name, port.baudrate), name, port.baudrate)
        except PortError:  # its device node is not ready, or another process was quicker
            continue
        return True
    return False


def real_time_port(port: str | None) -> str | None:
    """Return the port; a simulated port is set to run in real time."""
    if port is None or not is_simulated(port) or "paced=" in port:
        return port
    return with_simulator_option(port, "paced=1")


def with_simulator_option(port: str, option: str) -> str:
    """Return the name of a simulated port with one more option, such as ``paced=1``."""
    return f"{port if ':' in port else port + ':'}{'&' if '?' in port else '?'}{option}"

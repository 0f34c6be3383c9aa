"""Bytes in and out: opens a port by its name, and says plainly why it cannot."""

from __future__ import annotations

import contextlib
import errno
import sys
from collections.abc import Callable
from importlib.metadata import entry_points
from pathlib import Path
from typing import Protocol, cast

import serial
from serial.tools import list_ports

from ikservo.errors import NoPortError, PortBusyError, PortError
from ikservo.hardware.holder import holder_of

__all__ = ["GROUP", "Transport", "open_transport"]

GROUP = "ikservo.ports"
"""Entry point group: ``name:anything`` is opened by the plug-in called ``name``."""

_BUSY = {errno.EBUSY, errno.EAGAIN, errno.EWOULDBLOCK}
_WRITE_TIMEOUT_S = 1.0  # a line that takes no bytes for so long is gone


class Transport(Protocol):
    """The part of pyserial's ``Serial`` that a port needs."""

    baudrate: int
    timeout: float | None

    @property
    def in_waiting(self) -> int:
        """Return how many bytes have arrived and wait."""
        ...

    def read(self, size: int = 1, /) -> bytes:
        """Return up to ``size`` bytes; fewer only once ``timeout`` seconds have passed."""
        ...

    def write(self, data: bytes, /) -> int | None:
        """Send bytes; return how many went out."""
        ...

    def reset_input_buffer(self) -> None:
        """Forget what has arrived."""
        ...

    def flush(self) -> None:
        """Return once everything written is on the line."""
        ...

    def close(self) -> None:
        """Give the port back."""
        ...


def open_transport(name: str, baud_rate: int) -> Transport:
    """Open a port.

    Args:
        name: A device (``/dev/ttyACM0``, ``COM3``), a pyserial URL (``socket://host:port``,
            ``rfc2217://…``), or ``plug-in:anything`` for an installed plug-in such as ``sim:``.
        baud_rate: Bits a second.

    Raises:
        NoPortError: There is no such port.
        PortBusyError: Another program holds it.
        PortError: It may not be opened.
    """
    if not name:
        raise NoPortError("", _known_devices())
    for plug_in in entry_points(group=GROUP, name=name.partition(":")[0]):
        return _open_plug_in(plug_in.load(), name, baud_rate)
    try:
        return _open_serial(name, baud_rate)
    except (OSError, ValueError) as error:
        raise _explained(name, error) from error


def _open_plug_in(opener: Callable[[str], Transport], name: str, baud_rate: int) -> Transport:
    try:
        transport = opener(name)
    except Exception as error:  # a plug-in has errors of its own; all mean that there is no port
        raise NoPortError(name, why=str(error)) from error
    transport.baudrate = baud_rate
    return transport


def _open_serial(name: str, baud_rate: int) -> Transport:
    port = serial.serial_for_url(
        name,
        baudrate=baud_rate,
        timeout=0,
        write_timeout=_WRITE_TIMEOUT_S,
        exclusive=None if "://" in name else True,  # a URL's other end may not know of locks
    )
    _lower_latency(port)
    return cast("Transport", port)


def _lower_latency(port: serial.SerialBase) -> None:
    """Ask an FTDI adapter to answer within 1 ms instead of 16; others have no such knob."""
    ask = cast("Callable[[bool], None] | None", getattr(port, "set_low_latency_mode", None))
    if ask:
        with contextlib.suppress(ValueError, OSError, NotImplementedError):
            ask(True)


def _explained(name: str, error: OSError | ValueError) -> PortError:
    code = error.errno if isinstance(error, OSError) else None
    if code in _BUSY:
        return PortBusyError(name, holder_of(name))
    if code in {errno.EACCES, errno.EPERM} or "PermissionError" in str(error):
        return PortError(f"The port {name} may not be opened by this user.", _permission(name))
    if "://" not in name and Path(name).exists():
        return PortError(f"The port {name} cannot be opened: {error}.")
    return NoPortError(name, _known_devices(), "" if code == errno.ENOENT else str(error))


def _permission(name: str) -> str:
    if sys.platform != "linux":
        return "Another program may hold it; end that program, or plug the adapter in again."
    group = "dialout"
    with contextlib.suppress(OSError, KeyError):
        group = Path(name).group()
    return (
        f"Join the group that owns it, then log in again: sudo usermod -aG {group} $USER "
        '(or a udev rule with TAG+="uaccess").'
    )


def _known_devices() -> list[str]:
    return sorted(port.device for port in list_ports.comports())

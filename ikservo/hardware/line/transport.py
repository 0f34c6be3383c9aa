"""Bytes in and out: opens a port by its name, and says plainly why it cannot."""

from __future__ import annotations

import contextlib
import socket
import sys
import warnings
from collections.abc import Callable
from importlib.metadata import entry_points
from typing import Any, NoReturn, Protocol, cast

import serial
from serial import rfc2217

from ikservo.errors import NoPortError
from ikservo.hardware.line.descriptor import Descriptor, has_descriptor
from ikservo.hardware.line.forking import abandon_in_forked_children
from ikservo.hardware.line.port_lock import PortLock, lock_of
from ikservo.hardware.line.why_closed import known_devices, why_closed

__all__ = ["GROUP", "Transport", "open_transport"]

GROUP = "ikservo.ports"
"""Entry point group: ``name:anything`` is opened by the plug-in called ``name``."""

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
        raise NoPortError("", known_devices())
    for plug_in in entry_points(group=GROUP, name=name.partition(":")[0]):
        return _open_plug_in(plug_in.load(), name, baud_rate)
    lock = PortLock() if "://" in name else lock_of(name)
    try:
        return cast("Transport", _Held(_open_serial(name, baud_rate), lock))
    except (OSError, ValueError, OverflowError) as error:
        lock.release()
        raise why_closed(name, baud_rate, error) from error


def _open_plug_in(opener: Callable[[str], Transport], name: str, baud_rate: int) -> Transport:
    try:
        transport = opener(name)
    except Exception as error:  # a plug-in has errors of its own; all mean that there is no port
        raise NoPortError(name, known_devices(), why=str(error)) from error
    transport.baudrate = baud_rate
    return transport


def _open_serial(name: str, baud_rate: int) -> serial.Serial:
    opener = rfc2217.Serial if name.startswith("rfc2217://") else serial.serial_for_url
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # pyserial's own, in its RFC 2217
        port = opener(
            name,
            baudrate=baud_rate,
            timeout=0,
            write_timeout=None if "://" in name else _WRITE_TIMEOUT_S,
            exclusive=None if "://" in name else True,  # a URL's other end may not know of locks
        )
    _lower_latency(port)
    _send_at_once(port)
    return cast("serial.Serial", port)


class _Held:
    """A pyserial port, and the lock that is given back with it.

    Both belong to the process that opened them; see ``forking``. ``abandoned`` says that this
    process is a fork of it.

    Setting pyserial's ``timeout`` reconfigures the device, over the network where it stands
    there, although only ``read`` looks at it; so where that is possible it is set past pyserial.
    """

    def __init__(self, port: serial.Serial, lock: PortLock) -> None:
        self._port, self._lock = port, lock
        self.read, self.write, self.flush = port.read, port.write, port.flush
        self.reset_input_buffer = port.reset_input_buffer
        self._files = Descriptor(cast("Any", port)) if has_descriptor(port) else None
        if self._files:
            self.read, self.write = self._files.read, self._files.write
        if isinstance(port, rfc2217.Serial):
            self.reset_input_buffer = self._forget  # pyserial would wait for the server to agree
        self.abandoned = False
        abandon_in_forked_children(self)

    @property
    def in_waiting(self) -> int:
        return self._port.in_waiting

    @property
    def baudrate(self) -> int:
        return self._port.baudrate

    @baudrate.setter
    def baudrate(self, baud_rate: int) -> None:
        self._port.baudrate = baud_rate

    @property
    def timeout(self) -> float | None:
        return self._files.timeout if self._files else self._port.timeout

    @timeout.setter
    def timeout(self, timeout_s: float | None) -> None:
        if self._files:
            self._files.timeout = timeout_s
        elif sys.platform == "win32" and "://" not in str(self._port.port):
            self._port.timeout = timeout_s
        else:
            vars(self._port)["_timeout"] = timeout_s

    def _forget(self) -> None:
        while waiting := self._port.in_waiting:
            self._port.read(waiting)

    def abandon(self) -> None:
        connection = vars(self._port).get("_socket")
        with contextlib.suppress(OSError):
            if connection is not None:  # pyserial's own close would shut the parent's down, too
                connection.close()
            elif self._files:
                self._port.close()
        self._lock.release()
        self.read = self.write = self.flush = self.reset_input_buffer = _not_ours
        self.abandoned = True

    def close(self) -> None:
        if self.abandoned:
            return
        connection = vars(self._port).get("_socket")
        try:
            self._port.close()
        finally:
            if connection is not None:  # pyserial forgets it where the other end was quicker
                connection.close()
            self._lock.release()


def _lower_latency(port: serial.SerialBase) -> None:
    """Ask an FTDI adapter to answer within 1 ms instead of 16; others have no such knob."""
    ask = cast("Callable[[bool], None] | None", getattr(port, "set_low_latency_mode", None))
    if ask:
        with contextlib.suppress(ValueError, OSError, NotImplementedError):
            ask(True)


def _send_at_once(port: serial.SerialBase) -> None:
    """Let a network port send each packet when it is written (TCP_NODELAY).

    TCP would otherwise hold a goal back until the answer to the question before is confirmed, up
    to 40 ms later; pyserial sets this for ``rfc2217://`` only.
    """
    connection = vars(port).get("_socket")
    if isinstance(connection, socket.socket):
        with contextlib.suppress(OSError):
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)


def _not_ours(*_: object) -> NoReturn:
    raise serial.SerialException("another process opened it")

"""Open byte transports: serial devices, pyserial URLs, plug-ins.

Before each read and after each write, pyserial makes an extra system call so that another thread
can wake it; ikservo does not need this. With six servos that reply in sequence, these calls take a
third of a cycle.
"""

from __future__ import annotations

import contextlib
import os
import socket
import sys
import warnings
from collections.abc import Callable
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from select import select
from time import monotonic
from typing import Any, Protocol, cast
from weakref import WeakSet

from ikservo.errors import InputError, NoPortError, PortBusyError, PortError
from ikservo.hardware.port_lock import PortLock, acquire_lock
from ikservo.hardware.serial_ports import list_devices, open_error
from ikservo.hardware.vendor_modules import importing_from
from ikservo.remedies import install_hint

with importing_from("pyserial", "serial"):
    import serial
    from serial import rfc2217


class _ForkAware(Protocol):
    """An object with open files that a forked child must not keep."""

    def abandon(self) -> None:
        """Close this process's copies of the files; the parent keeps its own unchanged."""
        ...


# Python opens files so that programs started with `exec` do not inherit them. A child made by a
# plain `fork` (`os.fork`, `multiprocessing` with its method "fork") has a copy of every open file:
# it would keep the lock of a port after its parent was killed, and could write to the servos.
_fork_aware: WeakSet[_ForkAware] = WeakSet()


def abandon_in_forked_children(resource: _ForkAware) -> None:
    """Call ``resource.abandon()`` in every child that is forked while the resource exists."""
    _fork_aware.add(resource)


def _abandon_all_in_child() -> None:
    for resource in list(_fork_aware):
        resource.abandon()
    _fork_aware.clear()


if hasattr(os, "register_at_fork"):  # not on Windows, which has no fork
    os.register_at_fork(after_in_child=_abandon_all_in_child)


class _PosixSerial(Protocol):
    """The part of pyserial's POSIX port that ikservo uses."""

    fd: int
    write: Callable[[bytes], int | None]


def has_descriptor(port: object) -> bool:
    """Check whether a pyserial port has a file descriptor: not on Windows or ``spy://``."""
    reads_file = getattr(type(port), "read", None) is serial.Serial.read
    return os.name == "posix" and reads_file and isinstance(getattr(port, "fd", None), int)


class FileDescriptorPort:
    """Reader and writer of a port's file descriptor; pyserial opens and closes the port.

    Attributes:
        timeout: The time that ``read`` waits, seconds.
    """

    def __init__(self, port: _PosixSerial) -> None:
        self._port = port
        self.timeout: float | None = 0.0

    def read(self, size: int = 1, /) -> bytes:
        """Read up to ``size`` bytes; fewer only once ``timeout`` has passed."""
        left_s = self.timeout or 0.0
        give_up_s = monotonic() + left_s
        data = b""
        while len(data) < size and select((self._port.fd,), (), (), left_s)[0]:
            chunk = os.read(self._port.fd, size - len(data))
            if not chunk:
                raise serial.SerialException("device unplugged")
            data += chunk
            left_s = max(0.0, give_up_s - monotonic())
        return data

    def write(self, data: bytes, /) -> int:
        """Send bytes; pyserial waits if the line does not accept all of them at once."""
        sent = os.write(self._port.fd, data)
        if sent < len(data):
            self._port.write(data[sent:])
        return len(data)


ENTRY_POINT_GROUP = "ikservo.ports"
"""Entry point group: the plug-in called ``name`` opens ``name:anything``."""

NETWORK_GROUP = "ikservo.networks"
"""Entry point group: ``name:anything`` is the address of an arm on another machine."""

_WRITE_TIMEOUT_S = 1.0  # a line that accepts no bytes for this time is lost


class Transport(Protocol):
    """The part of pyserial's ``Serial`` that a port needs."""

    baudrate: int
    timeout: float | None

    @property
    def in_waiting(self) -> int:
        """Number of bytes that have arrived and are waiting."""
        ...

    def read(self, size: int = 1, /) -> bytes:
        """Read up to ``size`` bytes; fewer only once ``timeout`` seconds have passed."""
        ...

    def write(self, data: bytes, /) -> int | None:
        """Send bytes; return the number of bytes sent."""
        ...

    def reset_input_buffer(self) -> None:
        """Discard received bytes."""
        ...

    def flush(self) -> None:
        """Return once all written bytes have been sent."""
        ...

    def close(self) -> None:
        """Close the transport."""
        ...


def open_transport(name: str, baud_rate: int) -> Transport:
    """Open a port.

    Args:
        name: A device (``/dev/ttyACM0``, ``COM3``), a pyserial URL (``socket://host:port``,
            ``rfc2217://…``), or ``plug-in:anything`` for an installed plug-in such as ``sim:``.
        baud_rate: Rate in bit/s.

    Raises:
        InputError: A plug-in cannot use the text after its name: its function raises a ValueError.
        NoPortError: There is no such port.
        PortBusyError: Another program has the port open.
        PortError: The user has no permission to open the port, or the port cannot be opened.
    """
    if not name:
        raise NoPortError("", list_devices())
    for plug_in in _find_plug_ins(name.partition(":")[0]):
        return _open_plug_in(plug_in.load(), name, baud_rate)
    refuse_other_machines(name)
    lock = PortLock()
    try:
        lock = lock if "://" in name else acquire_lock(name)
        return cast("Transport", _LockedTransport(_open_serial(name, baud_rate), lock))
    except PortBusyError:
        raise
    except Exception as error:  # options of pyserial's URLs can raise any error
        lock.release()
        raise open_error(name, baud_rate, error) from error


def refuse_other_machines(name: str) -> None:
    """Refuse the address of an arm on another machine, because the port of its servos is needed.

    Raises:
        PortError: The name is such an address.
    """
    if _find_plug_ins(name.partition(":")[0], NETWORK_GROUP):
        raise PortError(
            f"{name} is an arm on another machine; this needs the servos' own port.",
            "Run this on that machine, with the serial port of the arm, after `ikservo serve` "
            "has ended.",
        )


@cache
def _find_plug_ins(name: str, group: str = ENTRY_POINT_GROUP) -> tuple[EntryPoint, ...]:
    """Find the installed plug-ins with a name; searching all packages takes milliseconds."""
    return tuple(entry_points(group=group, name=name))


def _open_plug_in(opener: Callable[[str], Transport], name: str, baud_rate: int) -> Transport:
    try:
        transport = opener(name)
    except ValueError as error:
        why = str(error)
        message = f"{name} cannot be opened: {why.rstrip('.')}."
        raise InputError(message, install_hint(why)) from error
    except Exception as error:  # a plug-in's own errors all mean that there is no port
        raise NoPortError(name, list_devices(), why=str(error)) from error
    transport.baudrate = baud_rate
    return transport


def _open_serial(name: str, baud_rate: int) -> serial.Serial:
    opener = rfc2217.Serial if name.startswith("rfc2217://") else serial.serial_for_url
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)  # pyserial raises this one in RFC 2217
        port = opener(
            name,
            baudrate=baud_rate,
            timeout=0,
            write_timeout=None if "://" in name else _WRITE_TIMEOUT_S,
            exclusive=None if "://" in name else True,  # a URL's other end may not support locks
        )
    # An FTDI adapter has a latency of 16 ms; 1 ms is possible. Other adapters have no such setting.
    set_low_latency = cast(
        "Callable[[bool], None] | None", getattr(port, "set_low_latency_mode", None)
    )
    if set_low_latency:
        with contextlib.suppress(ValueError, OSError, NotImplementedError):
            set_low_latency(True)
    # Without this, TCP delays a goal until the reply to the previous request is acknowledged, up to
    # 40 ms later; pyserial sets it for ``rfc2217://`` only.
    connection = vars(port).get("_socket")
    if isinstance(connection, socket.socket):
        with contextlib.suppress(OSError):
            connection.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
    return cast("serial.Serial", port)


class _LockedTransport:
    """A pyserial port and its lock, which is released when the port is closed.

    Port and lock belong to the process that opened them: ``abandon`` closes a forked child's
    copies.

    Setting pyserial's ``timeout`` reconfigures the device, even over the network, although only
    ``read`` uses the value. If possible, the value is therefore set without pyserial.
    """

    def __init__(self, port: serial.Serial, lock: PortLock) -> None:
        self._port, self._lock = port, lock
        self.read, self.write, self.flush = port.read, port.write, port.flush
        self.reset_input_buffer = port.reset_input_buffer
        self._files = FileDescriptorPort(cast("Any", port)) if has_descriptor(port) else None
        if self._files:
            self.read, self.write = self._files.read, self._files.write
        if isinstance(port, rfc2217.Serial):
            # pyserial would wait until the server agrees.
            self.reset_input_buffer = self._drain_input
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

    def _drain_input(self) -> None:
        while waiting := self._port.in_waiting:
            self._port.read(waiting)

    def abandon(self) -> None:
        connection = vars(self._port).get("_socket")
        with contextlib.suppress(OSError):
            if connection is not None:  # pyserial's close would also shut down the parent's
                connection.close()
            elif self._files:
                self._port.close()
        self._lock.release()
        self.abandoned = True

    def close(self) -> None:
        if self.abandoned:
            return
        connection = vars(self._port).get("_socket")
        try:
            self._port.close()
        finally:
            if connection is not None:  # pyserial loses the socket if the other end closes first
                connection.close()
            self._lock.release()

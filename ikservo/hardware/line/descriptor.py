"""Reading and writing an open pyserial port with as few calls of the system as it takes.

pyserial asks the system twice where once would do, before each read and behind each write, for
a way to be woken by another thread that nobody here uses. With six servos that answer one after
the other, this is a third of what a cycle costs.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from select import select
from time import monotonic
from typing import Protocol

import serial

__all__ = ["Descriptor", "has_descriptor"]


class _Open(Protocol):
    """What of pyserial's POSIX port is used."""

    fd: int
    write: Callable[[bytes], int | None]


def has_descriptor(port: object) -> bool:
    """Return whether a pyserial port is a file of the system, not of Windows or a network."""
    return os.name == "posix" and isinstance(getattr(port, "fd", None), int)


class Descriptor:
    """The bytes of one port; opening, rates and closing stay with pyserial.

    Attributes:
        timeout: How long ``read`` waits, seconds.
    """

    def __init__(self, port: _Open) -> None:
        self._port = port
        self.timeout: float | None = 0.0

    def read(self, size: int = 1, /) -> bytes:
        """Return up to ``size`` bytes; fewer only once ``timeout`` has passed."""
        left_s = self.timeout or 0.0
        give_up_s = monotonic() + left_s
        data = b""
        while len(data) < size and select((self._port.fd,), (), (), left_s)[0]:
            data += self._arrived(size - len(data))
            left_s = max(0.0, give_up_s - monotonic())
        return data

    def _arrived(self, size: int) -> bytes:
        chunk = os.read(self._port.fd, size)
        if not chunk:
            raise serial.SerialException("device unplugged")
        return chunk

    def write(self, data: bytes, /) -> int:
        """Send bytes; pyserial waits for those that the line does not take at once."""
        sent = os.write(self._port.fd, data)
        if sent < len(data):
            self._port.write(data[sent:])
        return len(data)

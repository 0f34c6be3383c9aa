"""A transport that counts what passes and how long it takes: what is left is our own time."""

from __future__ import annotations

import time
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

from ikservo.hardware.line.transport import Transport

__all__ = ["Meter"]


class Meter:
    """Stands between a port and its transport.

    Attributes:
        inside_s: Processor time spent in the transport so far, seconds; waiting costs none.
        sent: Bytes written so far.
        received: Bytes read so far.
        heard: The bytes read, while ``listen`` is set.
    """

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self.inside_s = 0.0
        self.sent = self.received = 0
        self.listen = False
        self.heard = bytearray()

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401  # clock, line: what else it has
        return getattr(self._transport, name)

    @property
    def baudrate(self) -> int:
        """Return bits a second."""
        return self._transport.baudrate

    @baudrate.setter
    def baudrate(self, rate: int) -> None:
        self._transport.baudrate = rate

    @property
    def timeout(self) -> float | None:
        """Return the seconds that ``read`` waits."""
        return self._transport.timeout

    @timeout.setter
    def timeout(self, timeout_s: float | None) -> None:
        with self._timed():
            self._transport.timeout = timeout_s

    @property
    def in_waiting(self) -> int:
        """Return how many bytes wait."""
        with self._timed():
            return self._transport.in_waiting

    def read(self, size: int = 1, /) -> bytes:
        """Return up to ``size`` bytes."""
        started_s = time.thread_time()
        data = self._transport.read(size)
        self.inside_s += time.thread_time() - started_s
        self.received += len(data)
        if self.listen:
            self.heard += data
        return data

    def write(self, data: bytes, /) -> int | None:
        """Send bytes."""
        started_s = time.thread_time()
        written = self._transport.write(data)
        self.inside_s += time.thread_time() - started_s
        self.sent += len(data)
        return written

    def reset_input_buffer(self) -> None:
        """Forget what has arrived."""
        with self._timed():
            self._transport.reset_input_buffer()

    def flush(self) -> None:
        """Return once everything is on the line."""
        with self._timed():
            self._transport.flush()

    def close(self) -> None:
        """Give the port back."""
        self._transport.close()

    @contextmanager
    def _timed(self) -> Generator[None]:
        started_s = time.thread_time()
        try:
            yield
        finally:
            self.inside_s += time.thread_time() - started_s

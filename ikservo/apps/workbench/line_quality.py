"""Measure error rate and round-trip time of a serial line."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import cycle, islice
from typing import Any

from ikservo.errors import BusError
from ikservo.hardware.bus import ServoBus
from ikservo.hardware.transport import Transport
from ikservo.registers import RegisterName


@dataclass(frozen=True, slots=True)
class LineQuality:
    """The outcome of many reads without retries.

    Attributes:
        reads: Number of reads.
        lost: Number of reads without a usable reply, by servo id.
        round_trips_s: Durations of the reads with a reply, ascending.
    """

    reads: int
    lost: dict[int, int]
    round_trips_s: tuple[float, ...]

    @property
    def lost_fraction(self) -> float:
        """Return the fraction of reads that were lost."""
        return sum(self.lost.values()) / self.reads

    def round_trip_s(self, quantile: float) -> float:
        """Compute the quantile of the round trips, seconds."""
        return sorted_quantile(self.round_trips_s, quantile)


def sorted_quantile(ascending: Sequence[float], quantile: float) -> float:
    """Return a quantile of numbers in ascending order, which is one of them."""
    return ascending[min(int(quantile * len(ascending)), len(ascending) - 1)]


def measure_line_quality(
    bus: ServoBus,
    servo_ids: Sequence[int],
    reads: int = 1000,
    on_read: Callable[[int], None] | None = None,
) -> LineQuality:
    """Read the positions of servos in turn, many times.

    The bus must not retry requests, which would hide losses.

    Raises:
        PortLostError: The port is lost.
    """
    lost = dict.fromkeys(servo_ids, 0)
    took_s: list[float] = []
    for count, servo_id in enumerate(islice(cycle(servo_ids), reads), start=1):
        started_s = bus.clock.now_s()
        try:
            bus.read(servo_id, RegisterName.PRESENT_POSITION, raw=True)
            took_s.append(bus.clock.now_s() - started_s)
        except BusError:
            lost[servo_id] += 1
        if on_read:
            on_read(count)
    return LineQuality(reads, {i: n for i, n in lost.items() if n}, tuple(sorted(took_s)))


class MeteredTransport:
    """Wrapper around a transport that measures its bytes and processor time.

    Attributes:
        inside_s: Processor time spent in the transport so far, seconds, without waiting.
        sent: Bytes written so far.
        received: Bytes read so far.
        captured: The bytes read, while ``capture`` is set.
    """

    def __init__(self, transport: Transport) -> None:
        self._transport = transport
        self.inside_s = 0.0
        self.sent = self.received = 0
        self.capture = False
        self.captured = bytearray()

    def __getattr__(self, name: str) -> Any:  # noqa: ANN401  # clock, line, close
        return getattr(self._transport, name)

    @property
    def baudrate(self) -> int:
        """The baud rate, bit/s."""
        return self._transport.baudrate

    @baudrate.setter
    def baudrate(self, rate: int) -> None:
        self._transport.baudrate = rate

    @property
    def timeout(self) -> float | None:
        """Time-out of ``read``, seconds."""
        return self._transport.timeout

    @timeout.setter
    def timeout(self, timeout_s: float | None) -> None:
        with self._timed_transfer():
            self._transport.timeout = timeout_s

    @property
    def in_waiting(self) -> int:
        """Number of bytes that can be read."""
        with self._timed_transfer():
            return self._transport.in_waiting

    def read(self, size: int = 1, /) -> bytes:
        """Read up to ``size`` bytes."""
        started_s = time.thread_time()
        data = self._transport.read(size)
        self.inside_s += time.thread_time() - started_s
        self.received += len(data)
        if self.capture:
            self.captured += data
        return data

    def write(self, data: bytes, /) -> int | None:
        """Send bytes."""
        started_s = time.thread_time()
        written = self._transport.write(data)
        self.inside_s += time.thread_time() - started_s
        self.sent += len(data)
        return written

    def reset_input_buffer(self) -> None:
        """Discard received bytes."""
        with self._timed_transfer():
            self._transport.reset_input_buffer()

    def flush(self) -> None:
        """Wait until everything is sent."""
        with self._timed_transfer():
            self._transport.flush()

    @contextmanager
    def _timed_transfer(self) -> Generator[None]:
        started_s = time.thread_time()
        try:
            yield
        finally:
            self.inside_s += time.thread_time() - started_s

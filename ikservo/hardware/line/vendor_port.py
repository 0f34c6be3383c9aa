"""The part of a port that both vendor SDKs call: bytes in, bytes out, and until when to wait."""

# The camelCase names are the vendors': their packet handlers call them.
# ruff: noqa: N802

from __future__ import annotations

import contextlib
import errno
from collections.abc import Iterable
from math import ceil

from ikservo.clock import Clock, RealClock
from ikservo.errors import PortError, PortLostError
from ikservo.hardware.line.patience import Patience
from ikservo.hardware.line.transport import Transport

__all__ = ["VendorPort"]

_BITS_PER_BYTE = 10  # 8N1: start, eight data bits, stop

# A real adapter may hold bytes back for 16 ms, a busy machine for longer.
_REAL_S = (0.002, 0.040)
_VIRTUAL_S = (0.001, 0.020)


_AWAKE_S = 0.000_15  # so much earlier than due: the kernel wakes us late, and clocks differ
_WORTH_S = 0.000_15  # shorter naps cost more than they save


def _line_failures() -> tuple[type[Exception], ...]:
    """Return what pyserial lets through when the line is gone."""
    try:
        import termios  # noqa: PLC0415 (there is none on Windows)
    except ImportError:
        return OSError, TypeError
    return OSError, TypeError, termios.error  # TypeError: its descriptor was closed meanwhile


_LINE_FAILS = _line_failures()


class VendorPort:
    """Shaped like the vendors' ``PortHandler``, on a transport that is already open.

    Their packet handlers need all methods of that class to exist: ``readPort`` and the packet
    timeouts are there for them alone, since ``Listening`` receives.
    """

    def __init__(self, transport: Transport, name: str, baud_rate: int) -> None:
        self.connect(transport, name, baud_rate)

    def connect(self, transport: Transport, name: str, baud_rate: int) -> None:
        """Talk through this transport from now on; what was learned of another is forgotten."""
        self.transport = transport
        self.name, self.baudrate = name, baud_rate
        virtual: Clock | None = getattr(transport, "clock", None)
        self._virtual = virtual is not None
        self.clock: Clock = virtual or RealClock()
        self.patience = Patience(*(_VIRTUAL_S if virtual else _REAL_S))
        self.sent = b""
        self.is_open, self.is_using = True, False
        self.sent_all_s = self._packet_deadline_s = 0.0

    def wire_s(self, count: int) -> float:
        """Return how long bytes take on the wire, seconds."""
        return count * _BITS_PER_BYTE / self.baudrate

    def due_s(self, expected: int, delays_s: float) -> float:
        """Return when the answer to what was just sent is complete if nothing is late.

        Args:
            expected: Bytes of the answer.
            delays_s: Sum of the servos' return delays, seconds.
        """
        return max(self.sent_all_s, self.clock.now_s()) + self.wire_s(expected) + delays_s

    def read_until(self, size: int, deadline_s: float) -> bytes:
        """Return up to ``size`` bytes; fewer only when the deadline has passed.

        Raises:
            PortLostError: The line is gone.
        """
        data = more = self._read(size, deadline_s)
        while more and len(data) < size:  # a transport that does not wait for all of it
            more = self._read(size - len(data), deadline_s)
            data += more
        return data

    def _read(self, size: int, deadline_s: float) -> bytes:
        left_s = deadline_s - self.clock.now_s()
        try:
            if left_s <= 0:
                return self.transport.read(min(size, self.transport.in_waiting))
            self._wait_at_most(left_s)
            return self.transport.read(size)
        except _LINE_FAILS as error:
            raise self._loss(error) from error

    def read_some(self, size: int, deadline_s: float) -> bytes:
        """Return what comes first, up to ``size`` bytes; nothing once the deadline has passed."""
        first = self.read_until(1, deadline_s)
        return first + self.read_until(min(size - 1, self.getBytesAvailable()), 0.0)

    def nap(self, expected: int) -> None:
        """Sleep while the first of ``expected`` bytes cannot be all: one waking for many packets.

        Servos that keep a return delay only take longer. In virtual time nobody is woken.
        """
        if self._virtual:
            return
        due_s = self.sent_all_s + self.wire_s(expected) - _AWAKE_S
        if due_s - self.clock.now_s() > _WORTH_S:
            self.clock.sleep_until(due_s)

    def openPort(self) -> bool:
        """Return whether the port is open; it is opened by ``open_port``."""
        return self.is_open

    def closePort(self) -> None:
        """Give the line back; a line that is already lost is no trouble."""
        if self.is_open:
            self.is_open = False
            with contextlib.suppress(*_LINE_FAILS):
                self.transport.close()

    def clearPort(self) -> None:
        """Discard what has arrived: it answers some earlier question."""
        try:
            self.transport.reset_input_buffer()
        except _LINE_FAILS as error:
            raise self._loss(error) from error

    def setPortName(self, port_name: str) -> None:
        """Change the name in messages."""
        self.name = port_name

    def getPortName(self) -> str:
        """Return the name."""
        return self.name

    def setBaudRate(self, baudrate: int) -> bool:
        """Talk at another rate without opening the port anew; any rate the adapter makes.

        Raises:
            PortError: The adapter cannot make this rate; the old one stays.
            PortLostError: The line is gone.
        """
        try:
            self.transport.baudrate = baudrate
        except _LINE_FAILS as error:
            raise self._loss(error) from error
        except (ValueError, OverflowError) as error:
            self.transport.baudrate = self.baudrate
            raise PortError(
                f"The adapter at {self.name} cannot be set to {baudrate} baud ({error}).",
                f"It is still at {self.baudrate}. Choose a rate that the adapter supports.",
            ) from error
        self.baudrate = baudrate
        return True

    def getBaudRate(self) -> int:
        """Return bits a second."""
        return self.baudrate

    def getBytesAvailable(self) -> int:
        """Return how many bytes wait."""
        try:
            return self.transport.in_waiting
        except _LINE_FAILS as error:
            raise self._loss(error) from error

    def readPort(self, length: int) -> bytes:
        """Return up to ``length`` bytes before the packet timeout."""
        return self.read_until(length, self._packet_deadline_s)

    def writePort(self, packet: Iterable[int]) -> int:
        """Send a packet; return how many bytes went out."""
        self.sent = bytes(packet)
        now_s = self.clock.now_s()
        self.sent_all_s = max(now_s, self.sent_all_s) + self.wire_s(len(self.sent))
        try:
            written = self.transport.write(self.sent)
        except _LINE_FAILS as error:
            raise self._loss(error) from error
        return len(self.sent) if written is None else written

    def setPacketTimeout(self, packet_length: int) -> None:
        """Expect a packet of so many bytes from now."""
        self._packet_deadline_s = self.due_s(packet_length, 0.0) + self.patience.allowance_s

    def setPacketTimeoutMillis(self, msec: float) -> None:
        """Expect a packet within milliseconds from now."""
        self._packet_deadline_s = self.clock.now_s() + msec / 1000

    def isPacketTimeout(self) -> bool:
        """Return whether the expected packet is overdue."""
        return self.clock.now_s() > self._packet_deadline_s

    def _wait_at_most(self, left_s: float) -> None:
        # Setting a timeout may reconfigure the device, so it moves in steps of a tenth of a
        # millisecond, and the same value is not set twice.
        timeout_s = ceil(left_s * 10_000 - 1e-6) / 10_000
        if self.transport.timeout != timeout_s:
            self.transport.timeout = timeout_s

    def _loss(self, error: Exception) -> PortError:
        """Return the error that names what happened to the line."""
        if not self.is_open:
            return PortError(f"{self.name} was closed.", "Open it again.")
        if getattr(self.transport, "abandoned", False):
            return PortError(
                f"{self.name} was opened before this process was forked, by its parent.",
                "Open the port in the process that uses it, after the fork.",
            )
        return PortLostError(self.name, _loss_words(error))


def _loss_words(error: Exception) -> str:
    """Return why a port was lost; systems and pyserial report an unplugged device differently."""
    code = next(iter(error.args), None)
    if code in {errno.EIO, errno.ENXIO, errno.ENODEV, errno.EBADF} or "no data" in str(error):
        return "device unplugged"
    return str(error)

"""A serial port in the shape that both vendor SDKs call, with its own idea of time."""

# The camelCase names are the vendors': their packet handlers call them.
# ruff: noqa: N802

from __future__ import annotations

import contextlib
import threading
from collections.abc import Generator, Iterable
from math import ceil
from types import TracebackType

from ikservo.clock import Clock, RealClock
from ikservo.errors import PortLostError
from ikservo.hardware.patience import Patience
from ikservo.hardware.transport import Transport, open_transport

__all__ = ["Port", "open_port"]

_BITS_PER_BYTE = 10  # 8N1: start, eight data bits, stop
_LONGEST_BABBLE_S = 0.25

# A real adapter may hold bytes back for 16 ms, a busy machine for longer.
_REAL_S = (0.005, 0.040)
_VIRTUAL_S = (0.0015, 0.0015)


def _line_failures() -> tuple[type[Exception], ...]:
    """Return what pyserial lets through when the line is gone."""
    try:
        import termios  # noqa: PLC0415 (there is none on Windows)
    except ImportError:
        return OSError, TypeError
    return OSError, TypeError, termios.error  # TypeError: its descriptor was closed meanwhile


_LINE_FAILS = _line_failures()


def open_port(name: str, baud_rate: int) -> Port:
    """Open a port by its name, see ``open_transport``.

    Raises:
        PortError: It does not exist, is busy or may not be opened.
    """
    return Port(open_transport(name, baud_rate), name, baud_rate)


class Port:
    """One serial line, used by one thread at a time.

    What differs from the vendors' ``PortHandler``: stale input is really discarded (F1, D6),
    waits are sized to the question (F2), time is monotonic (F3, D7), reads block instead of
    spinning (F4), the port is exclusive (F5), every baud rate goes (F6, D8), and a lost line
    is one named error.

    Attributes:
        transport: What carries the bytes; nobody but the port reads or writes it.
        name: As the person gave it.
        clock: The transport's own virtual clock, or the machine's.
        lock: Held during a question and its answer (F17, D14).
        sent: The bytes of the latest question.
        is_using: The SDKs' own busy flag; ``exchange`` always clears it (F8, D9).
    """

    def __init__(self, transport: Transport, name: str, baud_rate: int) -> None:
        self.transport = transport
        self.name, self.baudrate = name, baud_rate
        virtual: Clock | None = getattr(transport, "clock", None)
        self.clock: Clock = virtual or RealClock()
        self.patience = Patience(*(_VIRTUAL_S if virtual else _REAL_S))
        self.lock = threading.RLock()
        self.sent = b""
        self.is_open, self.is_using = True, False
        self._unsettled = False
        self._packet_deadline_s = 0.0

    # --- what the drivers call ---

    @contextlib.contextmanager
    def exchange(self) -> Generator[None]:
        """Hold the line for one question and its answer, and leave it usable whatever happens."""
        with self.lock:
            self._settle()
            try:
                yield
            finally:
                self.is_using = False

    def wire_s(self, count: int) -> float:
        """Return how long bytes take on the wire, seconds."""
        return count * _BITS_PER_BYTE / self.baudrate

    def deadline_s(self, expected: int, delays_s: float) -> float:
        """Return when the answer to what was just sent must be complete.

        Args:
            expected: Bytes of the answer.
            delays_s: Sum of the servos' return delays, seconds.
        """
        wire_s = self.wire_s(len(self.sent) + expected)
        return self.clock.now_s() + wire_s + delays_s + self.patience.allowance_s

    def read_until(self, size: int, deadline_s: float) -> bytes:
        """Return up to ``size`` bytes; fewer only when the deadline has passed.

        Raises:
            PortLostError: The line is gone.
        """
        left_s = deadline_s - self.clock.now_s()
        with self._named_loss():
            if left_s <= 0:
                return self.transport.read(min(size, self.transport.in_waiting))
            self._wait_at_most(left_s)
            return self.transport.read(size)

    def unsettle(self) -> None:
        """Remember that an answer may still be on its way; the next question waits for it."""
        self._unsettled = True

    def _settle(self) -> None:
        """Listen until the line is silent for a whole answer window, and forget what came."""
        if not self._unsettled:
            return
        give_up_s = self.clock.now_s() + _LONGEST_BABBLE_S
        while self.read_until(1, self.clock.now_s() + self.patience.allowance_s):
            self.clearPort()
            if self.clock.now_s() > give_up_s:
                break
        self._unsettled = False

    def _wait_at_most(self, left_s: float) -> None:
        # Setting pyserial's timeout reconfigures the device, so it moves in steps of half a
        # millisecond, and the same value is not set twice.
        timeout_s = ceil(left_s * 2000 - 1e-6) / 2000
        if self.transport.timeout != timeout_s:
            self.transport.timeout = timeout_s

    @contextlib.contextmanager
    def _named_loss(self) -> Generator[None]:
        try:
            yield
        except _LINE_FAILS as error:
            raise PortLostError(self.name, str(error)) from error

    # --- what the vendors' packet handlers call ---

    def openPort(self) -> bool:
        """Return whether the port is open; it is opened by ``open_port``."""
        return self.is_open

    def closePort(self) -> None:
        """Give the line back; a line that is already lost is no trouble."""
        if self.is_open:
            self.is_open = False
            with contextlib.suppress(*_LINE_FAILS):
                self.transport.close()

    close = closePort

    def clearPort(self) -> None:
        """Discard what has arrived: it answers some earlier question."""
        with self._named_loss():
            self.transport.reset_input_buffer()

    def setPortName(self, port_name: str) -> None:
        """Change the name in messages."""
        self.name = port_name

    def getPortName(self) -> str:
        """Return the name."""
        return self.name

    def setBaudRate(self, baudrate: int) -> bool:
        """Talk at another rate without opening the port anew; any rate the adapter makes."""
        with self._named_loss():
            self.transport.baudrate = baudrate
        self.baudrate = baudrate
        return True

    def getBaudRate(self) -> int:
        """Return bits a second."""
        return self.baudrate

    def getBytesAvailable(self) -> int:
        """Return how many bytes wait."""
        with self._named_loss():
            return self.transport.in_waiting

    def readPort(self, length: int) -> bytes:
        """Return up to ``length`` bytes before the packet timeout."""
        return self.read_until(length, self._packet_deadline_s)

    def writePort(self, packet: Iterable[int]) -> int:
        """Send a packet; return how many bytes went out."""
        self.sent = bytes(packet)
        with self._named_loss():
            written = self.transport.write(self.sent)
        return len(self.sent) if written is None else written

    def setPacketTimeout(self, packet_length: int) -> None:
        """Expect a packet of so many bytes from now."""
        self._packet_deadline_s = self.deadline_s(packet_length, 0.0)

    def setPacketTimeoutMillis(self, msec: float) -> None:
        """Expect a packet within milliseconds from now."""
        self._packet_deadline_s = self.clock.now_s() + msec / 1000

    def isPacketTimeout(self) -> bool:
        """Return whether the expected packet is overdue."""
        return self.clock.now_s() > self._packet_deadline_s

    def __enter__(self) -> Port:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.closePort()

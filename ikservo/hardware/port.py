"""A serial port in the shape that both vendor SDKs expect: deadlines, flush, echo."""

from __future__ import annotations

import contextlib
import errno
import threading
from collections.abc import Generator, Iterable
from math import ceil
from types import TracebackType

from ikservo.clock import Clock, RealClock
from ikservo.errors import PortError, PortLostError
from ikservo.hardware.pending import AdaptiveTimeout, ByteRateCheck, LineHealth, PendingReplies
from ikservo.hardware.transport import Transport, open_transport

__all__ = ["Port", "SdkPort", "open_port"]


# The camelCase names are the vendors': their packet handlers call them.
# ruff: noqa: N802


_BITS_PER_BYTE = 10  # 8N1: start, eight data bits, stop

# A real adapter may hold bytes back for 16 ms, a busy machine for longer.
_REAL_S = (0.002, 0.040)
_VIRTUAL_S = (0.001, 0.020)


_BUSY_WAIT_S = 0.000_15  # so much earlier than due: the kernel wakes us late, and clocks differ
_MIN_SLEEP_S = 0.000_15  # shorter naps cost more than they save


def _port_loss_exceptions() -> tuple[type[Exception], ...]:
    """Return what pyserial lets through when the line is gone."""
    try:
        import termios  # noqa: PLC0415 (there is none on Windows)
    except ImportError:
        return OSError, TypeError
    return OSError, TypeError, termios.error  # TypeError: its descriptor was closed meanwhile


_LINE_FAILS = _port_loss_exceptions()


class SdkPort:
    """Shaped like the vendors' ``PortHandler``, on a transport that is already open.

    Their packet handlers need all methods of that class to exist: ``readPort`` and the packet
    timeouts are there for them alone, since ``ReplyReader`` receives.
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
        self.patience = AdaptiveTimeout(*(_VIRTUAL_S if virtual else _REAL_S))
        self.sent = b""
        self.is_open, self.is_using = True, False
        self.sent_all_s = self._packet_deadline_s = 0.0

    def wire_s(self, count: int) -> float:
        """Return how long bytes take on the wire, seconds."""
        return count * _BITS_PER_BYTE / self.baudrate

    def expected_at_s(self, expected: int, delays_s: float) -> float:
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
        data = more = self._read_transport(size, deadline_s)
        while more and len(data) < size:  # a transport that does not wait for all of it
            more = self._read_transport(size - len(data), deadline_s)
            data += more
        return data

    def _read_transport(self, size: int, deadline_s: float) -> bytes:
        left_s = deadline_s - self.clock.now_s()
        try:
            if left_s <= 0:
                return self.transport.read(min(size, self.transport.in_waiting))
            self._set_read_timeout(left_s)
            return self.transport.read(size)
        except _LINE_FAILS as error:
            raise self._port_lost_error(error) from error

    def read_some(self, size: int, deadline_s: float) -> bytes:
        """Return what comes first, up to ``size`` bytes; nothing once the deadline has passed."""
        first = self.read_until(1, deadline_s)
        return first + self.read_until(min(size - 1, self.getBytesAvailable()), 0.0)

    def sleep_until_due(self, expected: int) -> None:
        """Sleep while the first of ``expected`` bytes cannot be all: one waking for many packets.

        Servos that keep a return delay only take longer. In virtual time nobody is woken.
        """
        if self._virtual:
            return
        due_s = self.sent_all_s + self.wire_s(expected) - _BUSY_WAIT_S
        if due_s - self.clock.now_s() > _MIN_SLEEP_S:
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
            raise self._port_lost_error(error) from error

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
            raise self._port_lost_error(error) from error
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
            raise self._port_lost_error(error) from error

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
            raise self._port_lost_error(error) from error
        return len(self.sent) if written is None else written

    def setPacketTimeout(self, packet_length: int) -> None:
        """Expect a packet of so many bytes from now."""
        self._packet_deadline_s = self.expected_at_s(packet_length, 0.0) + self.patience.timeout_s

    def setPacketTimeoutMillis(self, msec: float) -> None:
        """Expect a packet within milliseconds from now."""
        self._packet_deadline_s = self.clock.now_s() + msec / 1000

    def isPacketTimeout(self) -> bool:
        """Return whether the expected packet is overdue."""
        return self.clock.now_s() > self._packet_deadline_s

    def _set_read_timeout(self, left_s: float) -> None:
        # Setting a timeout may reconfigure the device, so it moves in steps of a tenth of a
        # millisecond, and the same value is not set twice.
        timeout_s = ceil(left_s * 10_000 - 1e-6) / 10_000
        if self.transport.timeout != timeout_s:
            self.transport.timeout = timeout_s

    def _port_lost_error(self, error: Exception) -> PortError:
        """Return the error that names what happened to the line."""
        if not self.is_open:
            return PortError(f"{self.name} was closed.", "Open it again.")
        if getattr(self.transport, "abandoned", False):
            return PortError(
                f"{self.name} was opened before this process was forked, by its parent.",
                "Open the port in the process that uses it, after the fork.",
            )
        return PortLostError(self.name, _describe_loss(error))


def _describe_loss(error: Exception) -> str:
    """Return why a port was lost; systems and pyserial report an unplugged device differently."""
    code = next(iter(error.args), None)
    if code in {errno.EIO, errno.ENXIO, errno.ENODEV, errno.EBADF} or "no data" in str(error):
        return "device unplugged"
    return str(error)


def open_port(name: str, baud_rate: int) -> Port:
    """Open a port by its name, see ``open_transport``.

    Raises:
        PortError: It does not exist, is busy or may not be opened.
    """
    return Port(open_transport(name, baud_rate), name, baud_rate)


class Port(SdkPort):
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
        echoes: Whether the adapter hears itself; None while that is unknown.
        patience: How long to wait beyond what the wire takes.
        pace: How soon an answer can come at the earliest.
        trust: Whether the line has shown that it repeats or damages packets.
        ghosts: Which answers may still come.
        is_using: The SDKs' own busy flag; ``exchange`` always clears it (F8, D9).
    """

    def __init__(self, transport: Transport, name: str, baud_rate: int) -> None:
        self.lock = threading.RLock()
        super().__init__(transport, name, baud_rate)

    def connect(self, transport: Transport, name: str, baud_rate: int) -> None:
        """Talk through another transport from now on; what was learned of the old is forgotten."""
        super().connect(transport, name, baud_rate)
        self.pace, self.trust, self.ghosts = ByteRateCheck(), LineHealth(), PendingReplies()
        self.echoes: bool | None = None

    @contextlib.contextmanager
    def exchange(self) -> Generator[None]:
        """Hold the line for one question and its answer, and leave it usable whatever happens."""
        with self.lock:
            try:
                yield
            finally:
                self.is_using = False

    def stale_bytes(self, count: int) -> int:
        """Return how many of the bytes heard since the question are older than it."""
        since_s = self.clock.now_s() - self.sent_all_s
        return self.pace.excess_bytes(count - self._echo_bytes, since_s, self.wire_s(1))

    @property
    def is_clean(self) -> bool:
        """Whether all has been well of late, and nothing but the next answer can come."""
        return not (self.trust.suspect or self.ghosts.any_pending)

    def on_reply(self, heard: bytes | bytearray, answered: int) -> None:
        """Learn from a complete answer.

        Args:
            heard: Everything that came since the question.
            answered: Bytes of the answers themselves.
        """
        if self.sent in heard[: len(heard) - answered]:
            self.echoes = True
        elif len(heard) == answered:  # nothing else came, not even half an echo
            self.echoes = False
        since_s = self.clock.now_s() - self.sent_all_s
        self.patience.on_reply(since_s - self.wire_s(len(heard) - self._echo_bytes))
        self.pace.on_reply(answered, since_s, self.wire_s(1))

    @property
    def _echo_bytes(self) -> int:
        """Return how many bytes that come back may be our own."""
        return 0 if self.echoes is False else len(self.sent)

    def close(self) -> None:
        """Give the line back; a line that is already lost is no trouble."""
        self.closePort()

    def __enter__(self) -> Port:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        at: TracebackType | None,
    ) -> None:
        self.closePort()

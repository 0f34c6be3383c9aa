"""A serial port with the interface that both vendor SDKs expect."""

from __future__ import annotations

import contextlib
import errno
import os
import threading
from collections.abc import Collection, Generator, Iterable
from dataclasses import dataclass
from math import ceil
from typing import NoReturn
from weakref import WeakKeyDictionary

from ikservo.clock import Clock, RealClock
from ikservo.errors import PortError, PortLostError
from ikservo.hardware.late_replies import AdaptiveTimeout, ByteRateCheck, LineHealth, PendingReplies
from ikservo.hardware.transport import Transport, abandon_in_forked_children, open_transport

# The vendors' packet handlers call these methods by their camelCase names.
# ruff: noqa: N802

_BITS_PER_BYTE = 10  # 8N1: start, eight data bits, stop

# A real adapter may hold bytes back for 16 ms, a busy machine for longer.
_REAL_S = (0.002, 0.040)
_VIRTUAL_S = (0.001, 0.020)

_UNPLUGGED = {errno.EIO, errno.ENXIO, errno.ENODEV, errno.EBADF}
_PACKETS_VARIABLE = "IKSERVO_PACKETS"
_BUSY_WAIT_S = 0.000_15  # wake up this much earlier, because the kernel is late and clocks differ
_MIN_SLEEP_S = 0.000_15  # shorter sleeps take more time than they save


def _port_loss_exceptions() -> tuple[type[Exception], ...]:
    """Return the exceptions that pyserial raises when the port is lost."""
    try:
        import termios  # noqa: PLC0415 (there is none on Windows)
    except ImportError:
        return OSError, TypeError
    return OSError, TypeError, termios.error  # TypeError: the descriptor was closed meanwhile


_LINE_FAILS = _port_loss_exceptions()


class SdkPort:
    """The interface of the vendors' ``PortHandler`` on an open transport.

    The vendors' packet handlers need all methods of that class. ``readPort`` and the packet
    timeouts exist only for them, because ikservo receives with ``ReplyReader``.
    """

    def __init__(self, transport: Transport, name: str, baud_rate: int) -> None:
        self.connect(transport, name, baud_rate)

    def connect(self, transport: Transport, name: str, baud_rate: int) -> None:
        """Set the transport that is used from now on; reset the measurements."""
        self.transport = transport
        self.name, self.baudrate = name, baud_rate
        virtual: Clock | None = getattr(transport, "clock", None)
        self._virtual = virtual is not None
        self.clock: Clock = virtual or RealClock()
        self.reply_timeout = AdaptiveTimeout(*(_VIRTUAL_S if virtual else _REAL_S))
        self.sent = b""
        self.is_open, self.is_using = True, False
        self.sent_all_s = self._packet_deadline_s = 0.0

    def wire_s(self, count: int) -> float:
        """Compute the time that a number of bytes takes on the wire, seconds."""
        return count * _BITS_PER_BYTE / self.baudrate

    def expected_at_s(self, expected: int, delays_s: float) -> float:
        """Return the time when the last packet's reply is complete, after the return delays."""
        return max(self.sent_all_s, self.clock.now_s()) + self.wire_s(expected) + delays_s

    def read_until(self, size: int, deadline_s: float) -> bytes:
        """Read up to ``size`` bytes; fewer only when the deadline has passed.

        Raises:
            PortLostError: The port is lost.
        """
        data = more = self._read_transport(size, deadline_s)
        while more and len(data) < size:  # some transports return before all bytes have arrived
            more = self._read_transport(size - len(data), deadline_s)
            data += more
        return data

    def _read_transport(self, size: int, deadline_s: float) -> bytes:
        left_s = deadline_s - self.clock.now_s()
        try:
            if left_s <= 0:
                return self.transport.read(min(size, self.transport.in_waiting))
            # Setting a timeout may reconfigure the device, so that it changes in steps of a tenth
            # of a millisecond, and the same value is not set twice.
            timeout_s = ceil(left_s * 10_000 - 1e-6) / 10_000
            if self.transport.timeout != timeout_s:
                self.transport.timeout = timeout_s
            return self.transport.read(size)
        except _LINE_FAILS as error:
            raise self._port_lost_error(error) from error

    def read_some(self, size: int, deadline_s: float) -> bytes:
        """Read the first bytes that arrive, up to ``size``; nothing if the deadline has passed."""
        first = self.read_until(1, deadline_s)
        return first + self.read_until(min(size - 1, self.getBytesAvailable()), 0.0)

    def sleep_until_due(self, expected: int) -> None:
        """Sleep until ``expected`` bytes can have arrived, so as to wake up once for many packets.

        Servos' return delays are ignored, because they only add time. Virtual time needs no sleep.
        """
        if self._virtual:
            return
        due_s = self.sent_all_s + self.wire_s(expected) - _BUSY_WAIT_S
        if due_s - self.clock.now_s() > _MIN_SLEEP_S:
            self.clock.sleep_until(due_s)

    def openPort(self) -> bool:
        """Check whether the port is open; ``open_port`` opens it."""
        return self.is_open

    def closePort(self) -> None:
        """Close the port; a port that is already lost is not an error."""
        self.disconnect()

    def disconnect(self) -> None:
        """Close the transport; ``connect`` can then set another one."""
        if self.is_open:
            self.is_open = False
            with contextlib.suppress(*_LINE_FAILS):
                self.transport.close()

    def clearPort(self) -> None:
        """Discard received bytes, because they reply to some earlier request."""
        try:
            self.transport.reset_input_buffer()
        except _LINE_FAILS as error:
            raise self._port_lost_error(error) from error

    def setPortName(self, port_name: str) -> None:
        """Change the name that messages use for the port."""
        self.name = port_name

    def getPortName(self) -> str:
        """Return the port's name."""
        return self.name

    def setBaudRate(self, baudrate: int) -> bool:
        """Change the baud rate without opening the port again; any rate of the adapter is possible.

        Raises:
            PortError: The adapter does not support this rate; the old rate stays.
            PortLostError: The port is lost.
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
        """Return the rate in bit/s."""
        return self.baudrate

    def getBytesAvailable(self) -> int:
        """Return the number of waiting bytes."""
        try:
            return self.transport.in_waiting
        except _LINE_FAILS as error:
            raise self._port_lost_error(error) from error

    def readPort(self, length: int) -> bytes:
        """Return up to ``length`` bytes before the packet timeout."""
        return self.read_until(length, self._packet_deadline_s)

    def writePort(self, packet: Iterable[int]) -> int:
        """Send a packet; return the number of bytes sent."""
        self.sent = bytes(packet)
        now_s = self.clock.now_s()
        self.sent_all_s = max(now_s, self.sent_all_s) + self.wire_s(len(self.sent))
        try:
            written = self.transport.write(self.sent)
        except _LINE_FAILS as error:
            raise self._port_lost_error(error) from error
        return len(self.sent) if written is None else written

    def setPacketTimeout(self, packet_length: int) -> None:
        """Set the deadline for a packet of this many bytes, from now."""
        self._packet_deadline_s = (
            self.expected_at_s(packet_length, 0.0) + self.reply_timeout.timeout_s
        )

    def setPacketTimeoutMillis(self, msec: float) -> None:
        """Set the deadline for a packet, milliseconds from now."""
        self._packet_deadline_s = self.clock.now_s() + msec / 1000

    def isPacketTimeout(self) -> bool:
        """Check whether the expected packet is overdue."""
        return self.clock.now_s() > self._packet_deadline_s

    def _port_lost_error(self, error: Exception) -> PortError:
        """Return an error that says how the port was lost."""
        if not self.is_open:
            return PortError(f"{self.name} was closed.", "Open it again.")
        if isinstance(self.transport, _ForeignTransport):
            text = f"{self.name} was opened by the parent process before the fork."
            return PortError(text, "Open the port in the process that uses it, after the fork.")
        # Systems and pyserial report an unplugged device differently.
        unplugged = next(iter(error.args), None) in _UNPLUGGED or "no data" in str(error)
        return PortLostError(self.name, "device unplugged" if unplugged else str(error))


class Port(SdkPort):
    """One serial line, used by one thread at a time.

    Differences from the vendors' ``PortHandler``: stale input is actually discarded (F1, D6 in
    docs/sdk-defects.md), waits are sized to the request (F2), time is monotonic (F3, D7), reads
    block instead of spinning (F4), the port is exclusive (F5), every baud rate is possible (F6,
    D8), and a lost port raises ``PortLostError``.

    Attributes:
        transport: Carries the bytes; only the port may read from it or write to it.
        name: The name that the user gave.
        clock: The transport's own virtual clock, or the machine's.
        lock: Held during a request and its reply (F17, D14).
        sent: The bytes of the latest request.
        echoes: Whether the adapter echoes; None while that is unknown.
        reply_timeout: The time to wait beyond the wire time.
        byte_rate: Checks how many bytes of a reply can have arrived since its request.
        health: Whether the line has repeated or damaged packets.
        pending: The replies that may still arrive.
        is_using: The SDKs' own busy flag; ``exchange`` always clears it (F8, D9).
    """

    def __init__(self, transport: Transport, name: str, baud_rate: int) -> None:
        self.lock = threading.RLock()
        super().__init__(transport, name, baud_rate)
        abandon_in_forked_children(self)

    def connect(self, transport: Transport, name: str, baud_rate: int) -> None:
        """Set the transport that is used from now on; discard the measurements of the old one."""
        super().connect(transport, name, baud_rate)
        self.byte_rate, self.health, self.pending = ByteRateCheck(), LineHealth(), PendingReplies()
        self.echoes: bool | None = None

    @contextlib.contextmanager
    def exchange(self) -> Generator[None]:
        """Hold the port for one request and its reply; always leave it usable."""
        with self.lock:
            try:
                yield
            finally:
                self.is_using = False

    def stale_bytes(self, count: int) -> int:
        """Compute how many of the bytes received since the request were sent before the request."""
        since_s = self.clock.now_s() - self.sent_all_s
        return self.byte_rate.excess_bytes(count - self._echo_bytes, since_s, self.wire_s(1))

    @property
    def is_clean(self) -> bool:
        """Whether the line is healthy and no other replies are pending."""
        return not (self.health.suspect or self.pending.any_pending)

    def on_reply(self, received: bytes | bytearray, reply_bytes: int) -> None:
        """Update timing and echo detection from all that was received with a complete reply."""
        if self.sent in received[: len(received) - reply_bytes]:
            self.echoes = True
        elif len(received) == reply_bytes:  # no other byte came, not even a part of an echo
            self.echoes = False
        since_s = self.clock.now_s() - self.sent_all_s
        self.reply_timeout.on_reply(since_s - self.wire_s(len(received) - self._echo_bytes))
        self.byte_rate.on_reply(reply_bytes, since_s, self.wire_s(1))

    @property
    def _echo_bytes(self) -> int:
        """Return the number of received bytes that may be an echo of the request."""
        return 0 if self.echoes is False else len(self.sent)

    def reopen(self) -> Port:
        """Return another port object with the same transport and state; it is closed separately."""
        opening = object.__new__(Port)
        opening.__dict__ = self.__dict__
        abandon_in_forked_children(opening)
        return opening

    def abandon(self) -> None:
        """Refuse all use in a forked child, even if a thread of the parent was using the port."""
        self.lock, self.is_using = threading.RLock(), False
        self.transport = _ForeignTransport(self.transport)

    def closePort(self) -> None:
        """Close this object; the last one closes the transport. A lost port is not an error."""
        with _opening:
            _openings.pop(self, None)
            if any(other.transport is self.transport for other in _openings):
                self.__dict__ = {**self.__dict__, "is_open": False, "transport": _ClosedTransport()}
            else:
                self.disconnect()

    def close(self) -> None:
        """Close the port; a port that is already lost is not an error."""
        self.closePort()

    def __enter__(self) -> Port:
        return self

    def __exit__(self, *_: object) -> None:
        self.closePort()


class _ClosedTransport:
    """Transport of a closed port object, which other objects may still use."""

    def __getattr__(self, name: str) -> NoReturn:
        raise OSError(errno.EBADF, "closed")

    def __setattr__(self, name: str, value: object) -> NoReturn:
        raise OSError(errno.EBADF, "closed")


class _ForeignTransport(_ClosedTransport):
    """Transport of a forked child in place of its parent's, which it does not close."""

    def __init__(self, transport: object) -> None:
        vars(self)["_transport"] = transport


@dataclass(frozen=True, slots=True)
class _Opening:
    """The arm and the servos for which a device is open."""

    device: str
    arm: str
    servo_ids: frozenset[int]


_openings: WeakKeyDictionary[Port, _Opening] = WeakKeyDictionary()
_opening = threading.Lock()


def _forget_openings() -> None:
    """Forget the parent's openings in a forked child."""
    global _opening  # noqa: PLW0603  # a thread of the parent may hold the old lock for ever
    _opening = threading.Lock()
    _openings.clear()


if hasattr(os, "register_at_fork"):  # not on Windows, which has no fork
    os.register_at_fork(after_in_child=_forget_openings)


def open_port(name: str, baud_rate: int, arm: str = "", servo_ids: Collection[int] = ()) -> Port:
    """Open a port by its name, see ``open_transport``.

    If this process already has the device open for other servos at the same rate, the port is
    shared; requests then wait for each other. If no ids of servos are given, the port is not
    shared.

    Raises:
        PortError: The port does not exist, is busy, or the user has no permission to open it.
    """
    if not name or ":" in name or not servo_ids:  # no device, simulated, remote, or for any servo
        return Port(_open_line(name, baud_rate), name, baud_rate)
    own = _Opening(os.path.realpath(name), arm, frozenset(servo_ids))
    with _opening:
        others = {
            port: other
            for port, other in _openings.items()
            if port.is_open and other.device == own.device
        }
        if others and all(other.servo_ids.isdisjoint(servo_ids) for other in others.values()):
            shared = next(iter(others))
            _check_sharing(shared, baud_rate, own, others.values())
            port = shared.reopen()
        else:
            port = Port(_open_line(name, baud_rate), name, baud_rate)
        _openings[port] = own
        return port


def _open_line(name: str, baud_rate: int) -> Transport:
    transport = open_transport(name, baud_rate)
    packets_path = os.environ.get(_PACKETS_VARIABLE)
    if not packets_path:
        return transport
    from ikservo.hardware.packet_log import recorded_transport  # noqa: PLC0415  # rarely needed

    try:
        return recorded_transport(transport, packets_path, name)
    except BaseException:
        transport.close()
        raise


def _check_sharing(port: Port, baud_rate: int, own: _Opening, others: Iterable[_Opening]) -> None:
    """Refuse an arm that cannot share an adapter with the arms that already use the adapter."""
    if port.baudrate != baud_rate:
        raise PortError(
            f"{port.name} is open at {port.baudrate} baud; {own.arm} needs {baud_rate}.",
            "All servos on one adapter need the same rate; ikservo setup sets it.",
        )
    if any(other.arm == own.arm for other in others):
        hint = "Give each arm on an adapter its own name in arm.toml."
        raise PortError(f"An arm named {own.arm} is open on {port.name} with other servos.", hint)

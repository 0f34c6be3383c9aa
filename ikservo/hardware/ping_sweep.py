"""Ping all ids at one baud rate, in every known framing.

Feetech servos and Dynamixel protocol 1.0 use the same framing, so one ping finds both;
protocol 2.0 has its own framing.

A reply contains the servo's id, so the next ping can be sent as soon as the wire is free; a reply
that a slow adapter holds back arrives later and is assigned correctly.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from typing import Protocol

from ikservo.hardware.packets import MAX_RETURN_DELAY_S, ScanResult, StatusPacket
from ikservo.hardware.port import Port
from ikservo.hardware.protocols import protocol1 as protocol_1
from ikservo.registers import MODELS, Family

_PING = 0x01


class _PacketScanner(Protocol):
    """Encoder of pings and decoder of replies, in one framing."""

    def ping(self, servo_id: int) -> bytes: ...
    def scan(self, data: bytes, *, final: bool) -> ScanResult: ...


@dataclass(frozen=True, slots=True)
class Framing:
    """A packet framing, its protocol families, and the lengths of a ping and its reply."""

    name: str
    families: tuple[Family, ...]
    ids: range
    ping_bytes: int
    reply_bytes: int

    @property
    def baud_rates(self) -> frozenset[int]:
        """Every rate that a known model of these families can be set to."""
        tables = [table for table in MODELS.values() if table.family in self.families]
        return frozenset(rate for table in tables for rate in table.baud_rates.values())

    def make_scanner(self) -> _PacketScanner:
        """Make the encoder and decoder of the framing."""
        return _Protocol2Framing() if Family.DYNAMIXEL_2 in self.families else _Protocol1Framing()


FRAMINGS = (
    Framing(
        "Feetech and Dynamixel 1.0",
        (Family.FEETECH_STS, Family.FEETECH_SCS, Family.DYNAMIXEL_1),
        ids=range(254),
        ping_bytes=6,
        reply_bytes=6,
    ),
    Framing("Dynamixel 2.0", (Family.DYNAMIXEL_2,), ids=range(253), ping_bytes=10, reply_bytes=14),
)


def framing_of(family: Family) -> Framing:
    """Return the framing that a family uses."""
    return next(framing for framing in FRAMINGS if family in framing.families)


# The vendors' handlers do not send these pings, because they clear the input before sending and
# lose the replies of other servos that are still on the line.


class _Protocol1Framing:
    def ping(self, servo_id: int) -> bytes:
        body = bytes((servo_id, 2, _PING))
        return bytes((0xFF, 0xFF, *body, protocol_1.checksum(body)))

    def scan(self, data: bytes, *, final: bool) -> ScanResult:
        return protocol_1.scan_packets(data, (0,), final=final)


class _Protocol2Framing:
    def __init__(self) -> None:
        from ikservo.hardware.protocols import protocol2  # noqa: PLC0415

        self._protocol = protocol2
        self._codec = protocol2.Protocol2Codec(too_long=0)  # this object sends nothing

    def ping(self, servo_id: int) -> bytes:
        body = bytes((0xFF, 0xFF, 0xFD, 0, servo_id, 3, 0, _PING))
        return body + self._protocol.crc(0, body, len(body)).to_bytes(2, "little")

    def scan(self, data: bytes, *, final: bool) -> ScanResult:
        return self._codec.scan(data, (3,), final=final)


_USB_FRAME_S = 0.001  # packets may leave an adapter this much closer than they were sent
_ECHO_ERROR = 1  # a ping of protocol 1 parses as a reply with this error byte
_ADAPTER_DELAY_S = 0.040  # adapters hold bytes back for up to 16 ms, busy machines for longer
_QUIET_PINGS = 3  # pings of one id without a reply before giving up
_RECENT_PINGS = 20  # latest pings whose replies an adapter may still hold back
_READ_CHUNK_BYTES = 4096  # more than can arrive in any slot


@dataclass(slots=True)
class PingResults:
    """Replies to pings.

    Attributes:
        frames: Every reply by id, in order of arrival.
        suspects: Ids in whose slots invalid bytes arrived: two servos replied at once, or noise.
        junk: The number of invalid bytes.
        echoes: Whether the adapter returns the bytes that it sends.
    """

    frames: dict[int, list[StatusPacket]] = field(default_factory=dict[int, "list[StatusPacket]"])
    suspects: set[int] = field(default_factory=set[int])
    junk: int = 0
    echoes: bool = False


def ping_ids(
    port: Port,
    framing: Framing,
    servo_ids: Iterable[int],
    on_ping: Callable[[int], None] | None = None,
    *,
    echoes: bool | None = None,
    one_by_one: bool = False,
) -> PingResults:
    """Ping ids one after another at the port's baud rate.

    The same id may be given several times. If ``echoes`` is None, echoes are detected, which needs
    several ids. With ``one_by_one``, wait for the reply to each ping, and briefly for a second
    reply; end the sweep early if the first pings get no reply.

    Raises:
        PortLostError: The port is lost.
    """
    ids = list(servo_ids)
    receiver = _ScanReceiver(framing)
    with port.exchange():
        port.clearPort()
        for count, servo_id in enumerate(ids, start=1):
            port.writePort(receiver.ping_packet(servo_id))
            first = b""
            if one_by_one:
                first = port.read_until(1, port.clock.now_s() + _ADAPTER_DELAY_S)
            slot_end_s = port.clock.now_s() + ping_slot_s(port, framing)
            receiver.feed(first + port.read_until(_READ_CHUNK_BYTES, slot_end_s))
            if on_ping:
                on_ping(count)
            if one_by_one and count == _QUIET_PINGS and not receiver.has_received:
                break
        tail_s = 0.0 if one_by_one else _ADAPTER_DELAY_S
        receiver.feed(port.read_until(_READ_CHUNK_BYTES, port.clock.now_s() + tail_s), final=True)
    return receiver.make_results(ids, echoes)


def ping_slot_s(port: Port, framing: Framing) -> float:
    """Compute the time after which the next ping cannot collide with the reply to this ping."""
    on_wire_s = port.wire_s(framing.ping_bytes + framing.reply_bytes)
    return on_wire_s + MAX_RETURN_DELAY_S + _USB_FRAME_S


class _ScanReceiver:
    """Parser of replies in the received bytes; assigns invalid bytes to the pinged ids."""

    def __init__(self, framing: Framing) -> None:
        self._codec = framing.make_scanner()
        self._pending = b""
        self._recent_ids: list[int] = []
        self._results = PingResults()

    @property
    def has_received(self) -> bool:
        """Whether any byte was received."""
        return bool(self._pending or self._results.frames or self._results.junk)

    def ping_packet(self, servo_id: int) -> bytes:
        """Return the packet that pings an id."""
        self._recent_ids = [*self._recent_ids[-_RECENT_PINGS:], servo_id]
        return self._codec.ping(servo_id)

    def feed(self, data: bytes, *, final: bool = False) -> None:
        """Add the bytes received since the last call."""
        unread = self._pending + data
        scanned = self._codec.scan(unread, final=final)
        self._pending = unread[len(unread) - scanned.pending :]
        for frame in scanned.frames:
            self._results.frames.setdefault(frame.servo_id, []).append(frame)
        if scanned.junk:
            self._results.junk += scanned.junk
            self._results.suspects.update(self._recent_ids)

    def make_results(self, ids: list[int], echoes: bool | None) -> PingResults:
        """Return the replies without the echoes of the pings."""
        pinged, results = Counter(ids), self._results
        if echoes is None:  # an adapter repeats every ping, a servo only the ping of its id
            all_repeated = all(len(self._echo_frames(i)) >= pinged[i] for i in pinged)
            echoes = len(pinged) > 1 and all_repeated
        results.echoes = echoes
        if echoes:
            for servo_id, count in pinged.items():
                for echo in self._echo_frames(servo_id)[:count]:
                    results.frames[servo_id].remove(echo)
        results.frames = {i: rows for i, rows in results.frames.items() if rows and i in pinged}
        return results

    def _echo_frames(self, servo_id: int) -> list[StatusPacket]:
        frames = self._results.frames.get(servo_id, ())
        return [frame for frame in frames if frame.error == _ECHO_ERROR and not frame.data]

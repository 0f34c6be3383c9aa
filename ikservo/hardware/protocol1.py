"""Protocol 1.0 packets and the driver base that Feetech, MX and AX servos share."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

from ikservo.hardware.driver import BroadcastPingResult, broadcast_ping
from ikservo.hardware.packets import (
    BROADCAST_ID,
    MemoryRange,
    PacketCodec,
    Reply,
    ScanResult,
    Status,
    StatusPacket,
)
from ikservo.hardware.port import Port
from ikservo.hardware.transceiver import PacketCache, Transceiver

__all__ = [
    "Protocol1Codec",
    "Protocol1Driver",
    "checksum",
    "packet_size",
    "parse_in_order",
    "scan_packets",
]


_HEADER = b"\xff\xff"
_LEN, _ERR, _DATA = 3, 4, 5  # where the bytes stand
_AROUND_LEN = 4  # header, id and the length byte itself are not counted in LEN
_HIGHEST_ID = 0xFD


def packet_size(size: int) -> int:
    """Return the bytes of a status packet with ``size`` bytes of data."""
    return size + 6


def checksum(body: bytes) -> int:
    """Return the inverted sum of everything between header and checksum."""
    return ~sum(body) & 0xFF


def parse_in_order(heard: bytes, sizes: Mapping[int, int]) -> dict[int, Reply] | None:
    """Return the answers, if the bytes are those of healthy servos in order and nothing else."""
    answers: dict[int, Reply] = {}
    at = 0
    for servo_id, size in sizes.items():
        end = at + size + 6
        # The sum of everything behind the header, its inverse included, has all bits set.
        if sum(heard[at + 2 : end]) & 0xFF != 0xFF:
            return None
        if heard[at : at + _DATA] != bytes((0xFF, 0xFF, servo_id, size + 2, 0)):
            return None
        answers[servo_id] = Status(servo_id, heard[at + _DATA : end - 1])
        at = end
    return answers


def scan_packets(heard: bytes, sizes: Collection[int], *, final: bool) -> ScanResult:
    """Find the status packets in what was heard.

    A false header does not hide a packet behind it (F11): where the checksum is wrong or the
    length is not the one asked for, the search goes on at the next byte.

    Args:
        heard: The bytes so far.
        sizes: Bytes of data in the answers that are hoped for.
        final: No more bytes will come.
    """
    frames: list[StatusPacket] = []
    at = junk = 0
    while at < len(heard):
        length = _packet_length(heard, at)
        if length is None or at + length > len(heard):
            if not final and _may_continue(heard, at, sizes):
                return ScanResult(tuple(frames), len(heard) - at, junk)
        elif _has_valid_checksum(heard, at, length) and not _is_spliced(
            heard, at, at + length, sizes
        ):
            frames.append(_parse_frame(heard[at : at + length]))
            at += length
            continue
        at, junk = at + 1, junk + 1
    return ScanResult(tuple(frames), 0, junk)


def _has_valid_checksum(heard: bytes, at: int, length: int) -> bool:
    end = at + length - 1
    return end < len(heard) and heard[end] == checksum(heard[at + 2 : end])


def _is_spliced(heard: bytes, at: int, end: int, sizes: Collection[int]) -> bool:
    """Return whether a hoped-for packet begins inside this one and goes on behind it.

    Then this is the beginning of a packet that broke off, and of the next: one checksum in 256 is
    right by chance.
    """
    inner = heard.find(_HEADER, at + 1, end + 1)
    while inner >= 0:
        length = _packet_length(heard, inner)
        if length is not None and _continues_behind(heard, inner, length, end, sizes):
            return True
        inner = heard.find(_HEADER, inner + 1, end + 1)
    return False


def _continues_behind(heard: bytes, at: int, length: int, end: int, sizes: Collection[int]) -> bool:
    wanted = length - packet_size(0) in sizes and at + length > end
    return wanted and _has_valid_checksum(heard, at, length)


def _packet_length(heard: bytes, at: int) -> int | None:
    """Return the length of the packet that seems to begin here, None if none does."""
    if heard[at : at + 2] != _HEADER or len(heard) <= at + _LEN:
        return None
    if heard[at + 2] > _HIGHEST_ID or heard[at + _LEN] < 2:
        return None
    return heard[at + _LEN] + _AROUND_LEN


def _may_continue(heard: bytes, at: int, sizes: Collection[int]) -> bool:
    """Return whether the bytes from here on may become a hoped-for packet."""
    start = heard[at : at + 4]
    if start[:2] != _HEADER[: len(start[:2])]:
        return False
    if len(start) > 2 and start[2] > _HIGHEST_ID and start[2] != 0xFF:
        return False
    if len(start) < 4:
        return True
    return start[2] <= _HIGHEST_ID and (start[3] == 2 or start[3] - 2 in sizes)


def _parse_frame(packet: bytes) -> StatusPacket:
    return StatusPacket(packet[2], packet[_ERR], packet[_DATA:-1])


_PING, _READ, _WRITE, _REG_WRITE, _ACTION = 0x01, 0x02, 0x03, 0x04, 0x05
_SYNC_WRITE = 0x83
_REQUEST_INSTRUCTIONS = frozenset(
    (_READ, 0x82, 0x92)
)  # of one servo, and of many: sync read, bulk read
_PING_SIZE = 0

SendPacket = Callable[[Port, list[int]], int]


class Protocol1Codec:
    """How status packets look; what they mean, each family says for itself."""

    def __init__(self, too_long: int) -> None:
        self.too_long = too_long

    def frame_size(self, size: int) -> int:
        """Return the bytes of a status packet with ``size`` bytes of data."""
        return packet_size(size)

    def scan(self, heard: bytes, sizes: Iterable[int], *, final: bool) -> ScanResult:
        """Find the status packets."""
        return scan_packets(heard, tuple(sizes), final=final)

    def parse_in_order(self, heard: bytes, sizes: Mapping[int, int]) -> dict[int, Reply] | None:
        """Return the answers, if the bytes are those of healthy servos in order, nothing else."""
        return parse_in_order(heard, sizes)

    def interpret(self, frame: StatusPacket, size: int) -> Reply | None:
        """Return what a frame says to a question for ``size`` bytes."""
        raise NotImplementedError


class Protocol1Driver:
    """Instructions that both families know.

    Args:
        port: The line.
        send: The vendor's ``txPacket``, which puts header and checksum around a packet.
        dialect: How this family's servos answer.
    """

    can_sync_read = can_bulk_write = already_retried = False

    def __init__(self, port: Port, send: SendPacket, dialect: PacketCodec) -> None:
        self._port, self._tx_packet = port, send
        self._send = PacketCache(port, self._send_packet, _REQUEST_INSTRUCTIONS).send
        self.transceiver = Transceiver(port, dialect)

    def set_return_delay(self, return_delay_s: float) -> None:
        """Wait no longer than this before each answer, seconds."""
        self.transceiver.set_return_delay(return_delay_s)

    def can_bulk_read(self, servo_ids: Iterable[int]) -> bool:
        """Whether one question can be put to these servos, each for its own bytes."""
        return False

    def ping(self, servo_id: int) -> Reply:
        """Ask whether a servo is there; a ping of this protocol tells nothing more (F14)."""
        return self._request_packet(servo_id, _PING, b"")

    def broadcast_ping(self, highest_id: int) -> BroadcastPingResult:
        """Ask everybody up to an id whether they are there."""
        return broadcast_ping(
            self.transceiver, lambda: self._send(BROADCAST_ID, _PING, b""), _PING_SIZE, highest_id
        )

    def read(self, servo_id: int, address: int, size: int) -> Reply:
        """Ask one servo for ``size`` bytes."""
        span = MemoryRange(address, size)
        with self._port.lock:
            window = self.transceiver.choose_window((servo_id,), span)
            parameters = bytes((window.address, window.size))
            return span.extract(self._request_packet(servo_id, _READ, parameters, window), window)

    def write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Write to one servo and hear whether it took it."""
        self._port.ghosts.invalidate((servo_id,))
        return self._request_packet(servo_id, _WRITE, bytes((address, *data)))

    def sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, Reply]:
        """Ask many servos for the same bytes, here one after the other."""
        return {servo_id: self.read(servo_id, address, size) for servo_id in servo_ids}

    def bulk_read(self, spans: Mapping[int, MemoryRange]) -> dict[int, Reply]:
        """Ask many servos, each for its own bytes, here one after the other."""
        return {i: self.read(i, span.address, span.size) for i, span in spans.items()}

    def sync_write(self, address: int, data: Mapping[int, bytes]) -> None:
        """Write to many servos at once; there is no answer to this."""
        size = len(next(iter(data.values())))
        rows = b"".join(bytes((servo_id, *row)) for servo_id, row in data.items())
        self._port.ghosts.invalidate(data, MemoryRange(address, size))
        parameters = bytes((address, size)) + rows
        self.transceiver.transact(lambda: self._send(BROADCAST_ID, _SYNC_WRITE, parameters))

    def bulk_write(self, rows: Mapping[int, tuple[int, bytes]]) -> None:
        """Write to many servos, each to its own address, here one write after the other."""
        for servo_id, (address, data) in rows.items():
            self.sync_write(address, {servo_id: data})

    def reg_write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Lay a write ready that ``action`` sets off."""
        return self._request_packet(servo_id, _REG_WRITE, bytes((address, *data)))

    def action(self) -> None:
        """Set off what ``reg_write`` laid ready, on every servo at the same moment."""
        self._port.ghosts.invalidate(range(BROADCAST_ID))
        self.transceiver.transact(lambda: self._send(BROADCAST_ID, _ACTION, b""))

    def _request_packet(
        self, servo_id: int, instruction: int, parameters: bytes, window: MemoryRange | None = None
    ) -> Reply:
        replies = self.transceiver.transact(
            lambda: self._send(servo_id, instruction, parameters),
            {servo_id: window.size if window else 0},
            window,
        )
        return replies[servo_id]

    def _send_packet(self, servo_id: int, instruction: int, parameters: bytes) -> int:
        packet = [0, 0, servo_id, len(parameters) + 2, instruction, *parameters, 0]
        return self._tx_packet(self._port, packet)

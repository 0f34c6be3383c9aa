"""Packets of protocol 1.0, and the driver base of Feetech, MX and AX servos."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

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
from ikservo.hardware.protocols.driver import BroadcastPingResult, broadcast_ping
from ikservo.hardware.protocols.transceiver import RepeatedPackets, Transceiver

_HEADER = b"\xff\xff"
_LEN, _ERR, _DATA = 3, 4, 5  # offsets of the bytes
_AROUND_LEN = 4  # header, id and the length byte itself are not counted in LEN
_HIGHEST_ID = 0xFD


def packet_size(size: int) -> int:
    """Compute the number of bytes in a status packet with ``size`` bytes of data."""
    return size + 6


def checksum(body: bytes) -> int:
    """Compute the inverted sum of all bytes between header and checksum."""
    return ~sum(body) & 0xFF


def parse_in_order(data: bytes, sizes: Mapping[int, int]) -> dict[int, Reply] | None:
    """Parse the bytes if they are exactly the expected replies, without errors and in order."""
    replies: dict[int, Reply] = {}
    at = 0
    for servo_id, size in sizes.items():
        end = at + size + 6
        # The sum of all bytes after the header, with the checksum, has all bits set.
        if sum(data[at + 2 : end]) & 0xFF != 0xFF:
            return None
        if data[at : at + _DATA] != bytes((0xFF, 0xFF, servo_id, size + 2, 0)):
            return None
        replies[servo_id] = Status(servo_id, data[at + _DATA : end - 1])
        at = end
    return replies


def scan_packets(data: bytes, sizes: Collection[int], *, final: bool) -> ScanResult:
    """Find the status packets in received bytes.

    A false header does not hide a packet after it (docs/sdk-defects.md F11): if the checksum or the
    length is wrong, the scan continues at the next byte. See ``Framing.scan``.
    """
    frames: list[StatusPacket] = []
    at = junk = 0
    while at < len(data):
        length = _packet_length(data, at)
        if length is None or at + length > len(data):
            if not final and _may_continue(data, at, sizes):
                return ScanResult(tuple(frames), len(data) - at, junk)
        elif _has_valid_checksum(data, at, length) and not _is_spliced(
            data, at, at + length, sizes
        ):
            packet = data[at : at + length]
            frames.append(StatusPacket(packet[2], packet[_ERR], packet[_DATA:-1]))
            at += length
            continue
        at, junk = at + 1, junk + 1
    return ScanResult(tuple(frames), 0, junk)


def _has_valid_checksum(data: bytes, at: int, length: int) -> bool:
    end = at + length - 1
    return end < len(data) and data[end] == checksum(data[at + 2 : end])


def _is_spliced(data: bytes, at: int, end: int, sizes: Collection[int]) -> bool:
    """Check whether an expected packet begins inside this packet and ends after it.

    This packet then consists of a truncated packet and the beginning of the next one; its checksum
    is right by chance in one of 256 cases.
    """
    inner = data.find(_HEADER, at + 1, end + 1)
    while inner >= 0:
        length = _packet_length(data, inner)
        if (
            length is not None
            and length - packet_size(0) in sizes
            and inner + length > end
            and _has_valid_checksum(data, inner, length)
        ):
            return True
        inner = data.find(_HEADER, inner + 1, end + 1)
    return False


def _packet_length(data: bytes, at: int) -> int | None:
    """Compute the length of the packet that seems to begin here; None if there is no packet."""
    if data[at : at + 2] != _HEADER or len(data) <= at + _LEN:
        return None
    if data[at + 2] > _HIGHEST_ID or data[at + _LEN] < 2:
        return None
    return data[at + _LEN] + _AROUND_LEN


def _may_continue(data: bytes, at: int, sizes: Collection[int]) -> bool:
    """Check whether an expected packet may begin here, complete or not."""
    start = data[at : at + 4]
    if start[:2] != _HEADER[: len(start[:2])]:
        return False
    if len(start) > 2 and start[2] > _HIGHEST_ID and start[2] != 0xFF:
        return False
    if len(start) < 4:
        return True
    return start[2] <= _HIGHEST_ID and (start[3] == 2 or start[3] - 2 in sizes)


_PING, _READ, _WRITE, _REG_WRITE, _ACTION = 0x01, 0x02, 0x03, 0x04, 0x05
_SYNC_WRITE = 0x83
_SYNC_READ, _BULK_READ = 0x82, 0x92
_REQUEST_INSTRUCTIONS = frozenset((_READ, _SYNC_READ, _BULK_READ))
_PING_SIZE = 0

SendPacket = Callable[[Port, list[int]], int]


class Protocol1Codec:
    """Status packet format; each family interprets the error byte itself."""

    def __init__(self, too_long: int) -> None:
        self.too_long = too_long

    def frame_size(self, size: int) -> int:
        """Return the number of bytes in a status packet with ``size`` bytes of data."""
        return packet_size(size)

    def scan(self, data: bytes, sizes: Iterable[int], *, final: bool) -> ScanResult:
        """Find the status packets."""
        return scan_packets(data, tuple(sizes), final=final)

    def parse_in_order(self, data: bytes, sizes: Mapping[int, int]) -> dict[int, Reply] | None:
        """Parse the bytes if they are exactly the expected replies, without errors and in order."""
        return parse_in_order(data, sizes)

    def interpret(self, frame: StatusPacket, size: int) -> Reply | None:
        """Interpret a frame as the reply to a request for ``size`` bytes; else return None."""
        raise NotImplementedError


class Protocol1Driver:
    """Base of the drivers for protocol 1.0, with the instructions that all families support.

    Args:
        port: The port.
        send: The vendor's ``txPacket``, which adds header and checksum to a packet.
        codec: The family's status packet codec.
    """

    can_sync_read = can_bulk_write = already_retried = False

    def __init__(self, port: Port, send: SendPacket, codec: PacketCodec) -> None:
        self._port, self._tx_packet = port, send
        self._repeated = RepeatedPackets(port, _REQUEST_INSTRUCTIONS)
        self.transceiver = Transceiver(port, codec)

    def set_return_delay(self, return_delay_s: float) -> None:
        """Set the maximum return delay before each reply, seconds."""
        self.transceiver.set_return_delay(return_delay_s)

    def can_bulk_read(self, servo_ids: Iterable[int]) -> bool:
        """Check whether one request can read different bytes of each of these servos."""
        return False

    def ping(self, servo_id: int) -> Reply:
        """Ping a servo; a reply in this protocol has no data (docs/sdk-defects.md F14)."""
        return self._request_packet(servo_id, _PING, b"")

    def broadcast_ping(self, highest_id: int) -> BroadcastPingResult:
        """Ping all ids up to the highest."""
        return broadcast_ping(
            self.transceiver, lambda: self._send(BROADCAST_ID, _PING, b""), _PING_SIZE, highest_id
        )

    def read(self, servo_id: int, address: int, size: int) -> Reply:
        """Read ``size`` bytes from one servo."""
        span = MemoryRange(address, size)
        with self._port.lock:
            window = self.transceiver.choose_window((servo_id,), span)
            parameters = bytes((window.address, window.size))
            return span.extract(self._request_packet(servo_id, _READ, parameters, window), window)

    def write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Write to one servo and check its reply."""
        self._port.pending.invalidate((servo_id,))
        return self._request_packet(servo_id, _WRITE, bytes((address, *data)))

    def sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, Reply]:
        """Read the same bytes from many servos, here one after the other."""
        return {servo_id: self.read(servo_id, address, size) for servo_id in servo_ids}

    def bulk_read(self, spans: Mapping[int, MemoryRange]) -> dict[int, Reply]:
        """Read different bytes from each servo, here one after the other."""
        return {i: self.read(i, span.address, span.size) for i, span in spans.items()}

    def sync_write(self, address: int, data: Mapping[int, bytes]) -> None:
        """Write to many servos with one packet; there is no reply."""
        size = len(next(iter(data.values())))
        rows = b"".join(bytes((servo_id, *row)) for servo_id, row in data.items())
        self._port.pending.invalidate(data, MemoryRange(address, size))
        parameters = bytes((address, size)) + rows
        self.transceiver.transact(lambda: self._send(BROADCAST_ID, _SYNC_WRITE, parameters))

    def bulk_write(self, rows: Mapping[int, tuple[int, bytes]]) -> None:
        """Write to many servos, each at its own address, here one write after the other."""
        for servo_id, (address, data) in rows.items():
            self.sync_write(address, {servo_id: data})

    def reg_write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Prepare a write that ``action`` executes."""
        return self._request_packet(servo_id, _REG_WRITE, bytes((address, *data)))

    def action(self) -> None:
        """Execute the prepared writes of all servos at the same time."""
        self._port.pending.invalidate(range(BROADCAST_ID))
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

    def _send(self, servo_id: int, instruction: int, parameters: bytes) -> int:
        """Send a packet, through the vendor's SDK if it is new; return the SDK's result code."""
        key = (servo_id, instruction, parameters)
        if (result := self._repeated.send(key)) is not None:
            return result
        packet = [0, 0, servo_id, len(parameters) + 2, instruction, *parameters, 0]
        return self._repeated.record_sent(key, self._tx_packet(self._port, packet))

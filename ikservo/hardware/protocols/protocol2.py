"""Protocol 2.0 packets: CRC, byte stuffing, fast sync read.

The reply to a fast sync read, ``FF FF FD 00 FE LEN 55 | ERR ID data CRC | ERR ID data CRC | …``, is
one status packet of id 0xFE whose data contain the inner checksums; nothing in it is stuffed.
"""

from __future__ import annotations

from array import array
from collections.abc import Collection, Mapping, Sequence
from functools import cache
from struct import unpack
from typing import cast

from ikservo.hardware.packets import FaultKind, Reply, ReplyFault, ScanResult, Status, StatusPacket
from ikservo.hardware.vendor_modules import importing_from

with importing_from("dynamixel-sdk", "dynamixel_sdk"):
    from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler

_UNSTUFFED, _STUFFED = b"\xff\xff\xfd", b"\xff\xff\xfd\xfd"


def stuff(inside: bytes) -> bytes:
    """Insert an FD after each FF FF FD between the length field and the CRC."""
    return inside.replace(_UNSTUFFED, _STUFFED)


def unstuff(inside: bytes) -> bytes:
    """Remove the FD after each FF FF FD.

    The SDK's own ``removeStuffing`` searches for FF FF FD FD in data that is not yet unstuffed and
    loses a byte of ``FF FF FD FF FD FD`` and similar data (docs/sdk-defects.md D2).
    """
    return inside.replace(_STUFFED, _UNSTUFFED)


_HEADER = b"\xff\xff\xfd\x00"
_LEN, _INSIDE = 5, 7  # offsets of the length field and the instruction
_STATUS = 0x55
MAX_PACKET_BYTES = 1024

_ALERT = 0x80
_CRC_ERROR = 3
_REFUSALS = {
    1: "could not execute it",
    2: "does not support the instruction",
    _CRC_ERROR: "received a damaged instruction packet",
    4: "reports a value out of range",
    5: "reports data of the wrong length",
    6: "reports a value beyond one of its limits",
    7: "denies access (read-only, no such address, or EEPROM while torque is on)",
}


def _byte_crc(byte: int) -> int:
    value = byte << 8
    for _ in range(8):
        value = value << 1 ^ (_POLYNOMIAL if value & 0x8000 else 0)
    return value & 0xFFFF


_POLYNOMIAL = 0x8005
_CRCS = tuple(map(_byte_crc, range(256)))


@cache
def _word_crc_table() -> Sequence[int]:
    """Compute the CRC of every pair of bytes on first use, so that each pair needs one lookup."""
    with_zero_behind = [(crc << 8 & 0xFF00) ^ _CRCS[crc >> 8] for crc in _CRCS]
    return array("H", [before ^ last for before in with_zero_behind for last in _CRCS])


def crc(start: int, packet: Sequence[int], count: int) -> int:
    """Compute the CRC-16 of a packet's first bytes: highest bit first, not reflected."""
    value, crcs = start, _word_crc_table()
    words = unpack(f">{count // 2}H", bytes(packet[: count & ~1]))
    for word in cast("Sequence[int]", words):
        value = crcs[value ^ word]
    if count % 2:
        value = (value << 8 & 0xFF00) ^ _CRCS[value >> 8 ^ packet[count - 1]]
    return value


class Protocol2Codec:
    """Codec of protocol 2.0; ``too_long`` is the SDK's code for a packet that is too long."""

    highest_id = 0xFC

    def __init__(self, too_long: int) -> None:
        self.too_long = too_long

    def encode_words(self, *numbers: int) -> bytes:
        """Encode addresses and sizes, two bytes each."""
        return b"".join(word.to_bytes(2, "little") for word in numbers)

    def instruct(self, servo_id: int, instruction: int, parameters: bytes) -> list[int]:
        """Build an unstuffed instruction packet; header and CRC are 0, the SDK fills them in."""
        length = (len(parameters) + 3).to_bytes(2, "little")
        return [0, 0, 0, 0, servo_id, *length, instruction, *parameters, 0, 0]

    def frame_size(self, size: int) -> int:
        """Compute the number of bytes in an unstuffed status packet with ``size`` bytes of data."""
        return size + 11

    def scan(self, data: bytes, sizes: Collection[int], *, final: bool) -> ScanResult:
        """Find the status packets; a false header does not hide a packet after it."""
        frames: list[StatusPacket] = []
        at = junk = 0
        while at < len(data):
            end = at + self._packet_length(data, at)
            if end > len(data) and not final and self._may_continue(data, at, sizes):
                return ScanResult(tuple(frames), len(data) - at, junk)
            if at < end <= len(data) and self._crc_is_right(data[at:end]):
                packet, at = data[at:end], end
                # An instruction, such as the echo of our own, is not a reply.
                if (
                    packet[_INSIDE] == _STATUS
                    and packet[4] <= self.highest_id
                    and len(packet) >= 11
                ):
                    inside = self._unstuff_body(packet[_INSIDE:-2])
                    frames.append(StatusPacket(packet[4], inside[1], inside[2:]))
            else:
                at, junk = at + 1, junk + 1
        return ScanResult(tuple(frames), 0, junk)

    def parse_in_order(self, data: bytes, sizes: Mapping[int, int]) -> dict[int, Reply] | None:
        """Parse the bytes if they are exactly the expected replies, without errors and in order."""
        replies: dict[int, Reply] = {}
        at = 0
        for servo_id, size in sizes.items():
            packet = data[at : at + self.frame_size(size)]
            reply = self._parse_plain_status(packet, servo_id, size)
            if reply is None:
                return None
            replies[servo_id] = reply
            at += len(packet)
        return replies

    def _parse_plain_status(self, packet: bytes, servo_id: int, size: int) -> Status | None:
        """Parse the reply in a packet that has no stuffing and no error; None for other packets."""
        expected = _HEADER + bytes((servo_id, size + 4 & 0xFF, size + 4 >> 8, _STATUS, 0))
        if packet[: _INSIDE + 2] != expected or _UNSTUFFED in packet[_INSIDE:]:
            return None
        if not self._crc_is_right(packet):
            return None
        return Status(servo_id, packet[_INSIDE + 2 : -2])

    def interpret(self, frame: StatusPacket, size: int) -> Reply | None:
        """Interpret a frame as data with an alert, or as a refusal; None if it is not the reply."""
        number, alert = frame.error & ~_ALERT, frame.error & _ALERT
        if number:
            kind = FaultKind.GARBLED if number == _CRC_ERROR else FaultKind.REFUSED
            found = _REFUSALS.get(number, f"answered with unknown error {number}")
            return ReplyFault(frame.servo_id, kind, found, alert)
        if len(frame.data) != size:
            return None  # a reply to some other request
        return Status(frame.servo_id, frame.data, alert)

    def _packet_length(self, data: bytes, at: int) -> int:
        """Compute the length of the packet that begins here; 0 for no packet, large if unknown."""
        start = data[at : at + _INSIDE]
        if start[:4] != _HEADER[: len(start)]:
            return 0
        if len(start) < _INSIDE:
            return MAX_PACKET_BYTES
        length = int.from_bytes(start[_LEN:], "little")
        return length + _INSIDE if 3 <= length <= MAX_PACKET_BYTES else 0

    def _crc_is_right(self, packet: bytes) -> bool:
        return crc(0, packet, len(packet) - 2) == int.from_bytes(packet[-2:], "little")

    def _may_continue(self, data: bytes, at: int, sizes: Collection[int]) -> bool:
        """Check whether an expected packet may begin here, complete or not."""
        start = data[at : at + _INSIDE + 1]
        if len(start) > 4 and start[4] > self.highest_id:
            return False
        if len(start) >= _INSIDE:
            count = int.from_bytes(start[_LEN:_INSIDE], "little") - 4
            # Stuffing adds at most one byte to every three, which may begin in the header.
            if count != 0 and not any(
                size <= count <= size + (size + 1) // 3 + 1 for size in sizes
            ):
                return False
        return len(start) <= _INSIDE or start[_INSIDE] == _STATUS

    def _unstuff_body(self, inside: bytes) -> bytes:
        return unstuff(inside)


class FastSyncCodec(Protocol2Codec):
    """Codec of the fast sync read packet: not stuffed, with the first servo's error byte."""

    highest_id = 0xFE

    def _parse_plain_status(self, packet: bytes, servo_id: int, size: int) -> Status | None:
        expected = _HEADER + bytes((servo_id, size + 4 & 0xFF, size + 4 >> 8, _STATUS))
        if packet[: _INSIDE + 1] != expected or not self._crc_is_right(packet):
            return None
        return Status(servo_id, packet[_INSIDE + 1 : -2])

    def interpret(self, frame: StatusPacket, size: int) -> Reply | None:
        """Return everything from the first servo's error byte on, if it is complete."""
        complete = len(frame.data) == size
        return Status(frame.servo_id, bytes((frame.error, *frame.data))) if complete else None

    def _unstuff_body(self, inside: bytes) -> bytes:
        return inside


# The SDK calls these methods by their camelCase names.
# ruff: noqa: N802
class FixedPacketHandler(Protocol2PacketHandler):
    """The SDK's packet handler with correct stuffing (D1, D2)."""

    def addStuffing(self, packet: list[int]) -> list[int]:
        """Stuff the packet in place, because ``txPacket`` ignores the return value."""
        inside = stuff(bytes(packet[_INSIDE:-2]))
        packet[_LEN:] = [*(len(inside) + 2).to_bytes(2, "little"), *inside, 0, 0]
        return packet

    def removeStuffing(self, packet: list[int]) -> list[int]:
        """Unstuff the packet in place."""
        inside = unstuff(bytes(packet[_INSIDE:-2]))
        packet[_LEN:-2] = [*(len(inside) + 2).to_bytes(2, "little"), *inside]
        return packet

    def updateCRC(self, crc_accum: int, data_blk_ptr: Sequence[int], data_blk_size: int) -> int:
        """Return the CRC; the SDK's own method would build a table for each packet."""
        return crc(crc_accum, data_blk_ptr, data_blk_size)


_OVERHEAD_BYTES = 4  # ERR, ID and CRC around each servo's data


def fast_sync_size(count: int, size: int) -> int:
    """Return the number of data bytes in the combined packet, without first ERR and last CRC."""
    return count * (size + _OVERHEAD_BYTES) - 3


def split_fast_sync(data: bytes, servo_ids: Sequence[int], size: int) -> list[StatusPacket]:
    """Split the combined packet into replies; empty if servos or order are not as requested.

    ``data`` are the bytes from the first ERR to the last data byte, which one checksum covers.
    """
    if len(data) != 1 + fast_sync_size(len(servo_ids), size):
        return []
    parts = [data[at : at + size + 2] for at in range(0, len(data), size + _OVERHEAD_BYTES)]
    if [part[1] for part in parts] != list(servo_ids):
        return []
    return [StatusPacket(part[1], part[0], part[2:]) for part in parts]

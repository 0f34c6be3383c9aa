"""Packets of protocol 1.0, which Feetech, MX and AX servos use."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping

from ikservo.hardware.packets import Reply, ScanResult, Status, StatusPacket

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


class Protocol1Codec:
    """Packet format; each family interprets the error byte itself."""

    def __init__(self, too_long: int) -> None:
        self.too_long = too_long

    def encode_words(self, *numbers: int) -> bytes:
        """Encode addresses and sizes, one byte each."""
        return bytes(numbers)

    def instruct(self, servo_id: int, instruction: int, parameters: bytes) -> list[int]:
        """Build an instruction packet; header and checksum are 0, the SDK fills them in."""
        return [0, 0, servo_id, len(parameters) + 2, instruction, *parameters, 0]

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

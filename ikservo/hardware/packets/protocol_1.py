"""The status packet ``FF FF ID LEN ERR data CHK`` of Feetech and of Dynamixel protocol 1.0."""

from __future__ import annotations

from collections.abc import Collection

from ikservo.hardware.packets.dialect import Frame, Heard

__all__ = ["checksum", "frame_size", "scan"]

_HEADER = b"\xff\xff"
_LEN, _ERR, _DATA = 3, 4, 5  # where the bytes stand
_AROUND_LEN = 4  # header, id and the length byte itself are not counted in LEN
_HIGHEST_ID = 0xFD


def frame_size(size: int) -> int:
    """Return the bytes of a status packet with ``size`` bytes of data."""
    return size + 6


def checksum(body: bytes) -> int:
    """Return the inverted sum of everything between header and checksum."""
    return ~sum(body) & 0xFF


def scan(heard: bytes, sizes: Collection[int], *, final: bool) -> Heard:
    """Find the status packets in what was heard.

    A false header does not hide a packet behind it (F11): where the checksum is wrong or the
    length is not the one asked for, the search goes on at the next byte.

    Args:
        heard: The bytes so far.
        sizes: Bytes of data in the answers that are hoped for.
        final: No more bytes will come.
    """
    frames: list[Frame] = []
    at = junk = 0
    while at < len(heard):
        length = _packet_length(heard, at)
        if length is None or at + length > len(heard):
            if not final and _may_continue(heard, at, sizes):
                return Heard(tuple(frames), len(heard) - at, junk)
        elif heard[at + length - 1] == checksum(heard[at + 2 : at + length - 1]):
            frames.append(_frame(heard[at : at + length]))
            at += length
            continue
        at, junk = at + 1, junk + 1
    return Heard(tuple(frames), 0, junk)


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


def _frame(packet: bytes) -> Frame:
    return Frame(packet[2], packet[_ERR], packet[_DATA:-1])

"""The status packet ``FF FF ID LEN ERR data CHK`` of Feetech and of Dynamixel protocol 1.0."""

from __future__ import annotations

from collections.abc import Collection, Mapping

from ikservo.hardware.packets.dialect import Frame, Heard
from ikservo.hardware.packets.replies import Reply, Status

__all__ = ["checksum", "frame_size", "in_order", "scan"]

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


def in_order(heard: bytes, sizes: Mapping[int, int]) -> dict[int, Reply] | None:
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
        elif _is_whole(heard, at, length) and not _is_spliced(heard, at, at + length, sizes):
            frames.append(_frame(heard[at : at + length]))
            at += length
            continue
        at, junk = at + 1, junk + 1
    return Heard(tuple(frames), 0, junk)


def _is_whole(heard: bytes, at: int, length: int) -> bool:
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
        if length is not None and _goes_on(heard, inner, length, end, sizes):
            return True
        inner = heard.find(_HEADER, inner + 1, end + 1)
    return False


def _goes_on(heard: bytes, at: int, length: int, end: int, sizes: Collection[int]) -> bool:
    wanted = length - frame_size(0) in sizes and at + length > end
    return wanted and _is_whole(heard, at, length)


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

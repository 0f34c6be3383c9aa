"""The status packet ``FF FF FD 00 ID LEN 55 ERR data CRC`` of Dynamixel protocol 2.0."""

from __future__ import annotations

from array import array
from collections.abc import Collection, Mapping, Sequence
from functools import cache
from struct import unpack
from typing import cast

from ikservo.hardware.packets.dialect import Frame, Heard
from ikservo.hardware.packets.replies import Fault, FaultKind, Reply, Status
from ikservo.hardware.packets.stuffing import unstuffed

__all__ = ["Answers", "CombinedAnswer", "crc"]

_HEADER = b"\xff\xff\xfd\x00"
_LEN, _INSIDE = 5, 7  # where the length field and the instruction stand
_STATUS = 0x55
_STUFFED = b"\xff\xff\xfd"
_LONGEST = 1024

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


def _crc_of_byte(byte: int) -> int:
    value = byte << 8
    for _ in range(8):
        value = value << 1 ^ (_POLYNOMIAL if value & 0x8000 else 0)
    return value & 0xFFFF


_POLYNOMIAL = 0x8005
_CRCS = tuple(map(_crc_of_byte, range(256)))


@cache
def _crcs_of_words() -> Sequence[int]:
    """Return the CRC of every two bytes, so that two cost one look; made when first needed."""
    with_zero_behind = [(crc << 8 & 0xFF00) ^ _CRCS[crc >> 8] for crc in _CRCS]
    return array("H", [before ^ last for before in with_zero_behind for last in _CRCS])


def crc(start: int, packet: Sequence[int], count: int) -> int:
    """Return the CRC-16 of a packet's first bytes: highest bit first, nothing reflected."""
    value, crcs = start, _crcs_of_words()
    words = unpack(f">{count // 2}H", bytes(packet[: count & ~1]))
    for word in cast("Sequence[int]", words):
        value = crcs[value ^ word]
    if count % 2:
        value = (value << 8 & 0xFF00) ^ _CRCS[value >> 8 ^ packet[count - 1]]
    return value


class Answers:
    """How servos of protocol 2.0 answer a question.

    Args:
        too_long: The SDK's code for a packet that is too long to send.
    """

    highest_id = 0xFC

    def __init__(self, too_long: int) -> None:
        self.too_long = too_long

    def frame_size(self, size: int) -> int:
        """Return the bytes of a status packet with ``size`` bytes of data, unstuffed."""
        return size + 11

    def scan(self, heard: bytes, sizes: Collection[int], *, final: bool) -> Heard:
        """Find the status packets; a false header does not hide a packet behind it."""
        frames: list[Frame] = []
        at = junk = 0
        while at < len(heard):
            end = at + self._packet_length(heard, at)
            if end > len(heard) and not final and self._may_continue(heard, at, sizes):
                return Heard(tuple(frames), len(heard) - at, junk)
            if at < end <= len(heard) and self._crc_is_right(heard[at:end]):
                frames += self._frames(heard[at:end])
                at = end
            else:
                at, junk = at + 1, junk + 1
        return Heard(tuple(frames), 0, junk)

    def in_order(self, heard: bytes, sizes: Mapping[int, int]) -> dict[int, Reply] | None:
        """Return the answers, if the bytes are those of healthy servos in order, nothing else."""
        answers: dict[int, Reply] = {}
        at = 0
        for servo_id, size in sizes.items():
            packet = heard[at : at + self.frame_size(size)]
            reply = self._plain(packet, servo_id, size)
            if reply is None:
                return None
            answers[servo_id] = reply
            at += len(packet)
        return answers

    def _plain(self, packet: bytes, servo_id: int, size: int) -> Status | None:
        """Return what a packet says that is neither stuffed nor complains, None for others."""
        expected = _HEADER + bytes((servo_id, size + 4 & 0xFF, size + 4 >> 8, _STATUS, 0))
        if packet[: _INSIDE + 2] != expected or _STUFFED in packet[_INSIDE:]:
            return None
        if not self._crc_is_right(packet):
            return None
        return Status(servo_id, packet[_INSIDE + 2 : -2])

    def judge(self, frame: Frame, size: int) -> Reply | None:
        """Return data with the alert beside them, a refusal in words, or None if no answer."""
        number, alert = frame.error & ~_ALERT, frame.error & _ALERT
        if number:
            kind = FaultKind.GARBLED if number == _CRC_ERROR else FaultKind.REFUSED
            found = _REFUSALS.get(number, f"answered with unknown error {number}")
            return Fault(frame.servo_id, kind, found, alert)
        if len(frame.data) != size:
            return None  # an answer to some other question
        return Status(frame.servo_id, frame.data, alert)

    def _packet_length(self, heard: bytes, at: int) -> int:
        """Return the length of the packet that begins here: 0 if none does, a lot if unknown."""
        start = heard[at : at + _INSIDE]
        if start[:4] != _HEADER[: len(start)]:
            return 0
        if len(start) < _INSIDE:
            return _LONGEST
        length = int.from_bytes(start[_LEN:], "little")
        return length + _INSIDE if 3 <= length <= _LONGEST else 0

    def _crc_is_right(self, packet: bytes) -> bool:
        return crc(0, packet, len(packet) - 2) == int.from_bytes(packet[-2:], "little")

    def _may_continue(self, heard: bytes, at: int, sizes: Collection[int]) -> bool:
        """Return whether the bytes from here on may become a hoped-for packet."""
        start = heard[at : at + _INSIDE + 1]
        if len(start) > 4 and start[4] > self.highest_id:
            return False
        if len(start) >= _INSIDE:
            data = int.from_bytes(start[_LEN:_INSIDE], "little") - 4
            if data != 0 and not any(size <= data <= _stuffed_at_most(size) for size in sizes):
                return False
        return len(start) <= _INSIDE or start[_INSIDE] == _STATUS

    def _frames(self, packet: bytes) -> list[Frame]:
        """Return the status frame of a packet; an instruction, such as our own echo, is none."""
        if packet[_INSIDE] != _STATUS or packet[4] > self.highest_id or len(packet) < 11:
            return []
        inside = self._unstuffed(packet[_INSIDE:-2])
        return [Frame(packet[4], inside[1], inside[2:])]

    def _unstuffed(self, inside: bytes) -> bytes:
        return unstuffed(inside)


def _stuffed_at_most(size: int) -> int:
    return size + (size + 1) // 3 + 1


class CombinedAnswer(Answers):
    """The one packet of a fast sync read: never stuffed, its error byte is the first servo's."""

    highest_id = 0xFE

    def _plain(self, packet: bytes, servo_id: int, size: int) -> Status | None:
        expected = _HEADER + bytes((servo_id, size + 4 & 0xFF, size + 4 >> 8, _STATUS))
        if packet[: _INSIDE + 1] != expected or not self._crc_is_right(packet):
            return None
        return Status(servo_id, packet[_INSIDE + 1 : -2])

    def judge(self, frame: Frame, size: int) -> Reply | None:
        """Return everything from the first servo's error byte on, if it is complete."""
        complete = len(frame.data) == size
        return Status(frame.servo_id, bytes((frame.error, *frame.data))) if complete else None

    def _unstuffed(self, inside: bytes) -> bytes:
        return inside

"""Frames of both protocols, and readers that find them in a stream of bytes."""

from __future__ import annotations

from array import array
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import lru_cache
from struct import Struct
from typing import ClassVar


@dataclass(frozen=True, slots=True)
class Frame:
    """One frame with a good checksum.

    Attributes:
        id: The addressed servo, or the servo that replies.
        instruction: The instruction byte; in a protocol 1 status, the error byte.
        params: The bytes after the instruction, without stuffing and checksum.
        end: Index after its last byte in the feed that completed it.
        raw: The frame as received.
    """

    id: int
    instruction: int
    params: bytes = b""
    end: int = 0
    raw: bytes = field(default=b"", compare=False, repr=False)


class FrameReader:
    """Finds frames in whatever arrives; junk and bad checksums are counted and skipped."""

    header: ClassVar[bytes]
    shortest: ClassVar[int]  # bytes needed before the length is known

    def __init__(self) -> None:
        self.junk_bytes = 0
        self.bad_checksums = 0
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Frame]:
        """Add bytes; return the frames that they complete, in order."""
        before = len(self._buffer)
        self._buffer += data
        frames: list[Frame] = []
        at = 0
        while (start := self._find_header(at)) is not None:
            size = self._size(start)
            if size is None or start + size > len(self._buffer):
                self._drop_bytes(at, start)
                return frames
            at = self._take_frame(at, start, size, before, frames)
        return frames

    def reset(self) -> None:
        """Discard an incomplete frame."""
        self.junk_bytes += len(self._buffer)
        self._buffer.clear()

    def _find_header(self, at: int) -> int | None:
        start = self._buffer.find(self.header, at)
        if start >= 0:
            return start
        keep = min(len(self.header) - 1, len(self._buffer) - at)
        while not self.header.startswith(self._buffer[len(self._buffer) - keep :]):
            keep -= 1
        self._drop_bytes(at, len(self._buffer) - keep)
        return None

    def _drop_bytes(self, at: int, start: int) -> None:
        self.junk_bytes += start - at
        del self._buffer[:start]

    def _take_frame(self, at: int, start: int, size: int, before: int, frames: list[Frame]) -> int:
        """Append the frame at ``start`` if it is valid; return where the search continues."""
        self.junk_bytes += start - at
        if size > 0:
            frame = self._parse(bytes(self._buffer[start : start + size]), start + size - before)
            if frame is not None:
                frames.append(frame)
                return start + size
            self.bad_checksums += 1
        self.junk_bytes += 1
        return start + 1

    def _size(self, start: int) -> int | None:
        """Return the whole frame's size, 0 for a false header, None if it is not known yet."""
        raise NotImplementedError

    def _parse(self, raw: bytes, end: int) -> Frame | None:
        """Parse the frame; None if its checksum is wrong."""
        raise NotImplementedError


def checksum(body: bytes) -> int:
    """Compute the inverted sum of everything between the header and the checksum."""
    return ~sum(body) & 0xFF


def encode1(id_: int, instruction: int, params: bytes = b"") -> bytes:
    """Return the frame; for a status, ``instruction`` is the error byte."""
    body = bytes((id_, len(params) + 2, instruction)) + params
    return b"\xff\xff" + body + bytes((checksum(body),))


class Dynamixel1Reader(FrameReader):
    """Reads protocol 1.0 and Feetech frames."""

    header = b"\xff\xff"
    shortest = 4

    def _size(self, start: int) -> int | None:
        buffer = self._buffer
        if start + 2 < len(buffer) and buffer[start + 2] == 0xFF:
            return 0
        if start + self.shortest > len(buffer):
            return None
        length = buffer[start + 3]
        return length + 4 if length >= 2 else 0

    def _parse(self, raw: bytes, end: int) -> Frame | None:
        if checksum(raw[2:-1]) != raw[-1]:
            return None
        return Frame(raw[2], raw[4], raw[5:-1], end, raw)


HEADER = b"\xff\xff\xfd\x00"
POLYNOMIAL = 0x8005  # CRC-16/BUYPASS, e-manual "protocol 2.0, CRC calculation"
MAX_FRAME_BYTES = 1024  # a header that announces more is taken for a false one


def _crc_row(byte: int) -> int:
    crc = byte << 8
    for _ in range(8):
        crc = (crc << 1) ^ POLYNOMIAL if crc & 0x8000 else crc << 1
    return crc & 0xFFFF


def _crc_pairs() -> array[int]:
    """Compute the CRC of every two bytes, the first of them the high byte of the index."""
    last = [_crc_row(byte) for byte in range(256)]
    first = [(crc << 8) & 0xFFFF ^ last[crc >> 8] for crc in last]
    return array("H", [a ^ b for a in first for b in last])


_CRC = _crc_pairs()


def crc16(data: bytes, crc: int = 0) -> int:
    """Compute the CRC of ``data`` after bytes with a given CRC, two bytes at a time."""
    table, odd = _CRC, len(data) & 1
    if odd:
        crc = (crc << 8) & 0xFFFF ^ table[crc >> 8 ^ data[0]]
    for pair in _pairs_reader(len(data) // 2)(data, odd):
        crc = table[crc ^ pair]
    return crc


@lru_cache(maxsize=1024)
def _pairs_reader(count: int) -> Callable[[bytes, int], tuple[int, ...]]:
    return Struct(f">{count}H").unpack_from


def stuff(body: bytes) -> bytes:
    """Insert an FD after every ``FF FF FD``, so that no header appears inside a frame."""
    return body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")


def unstuff(body: bytes) -> bytes:
    """Undo ``stuff``."""
    return body.replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")


def encode2(id_: int, instruction: int, params: bytes = b"") -> bytes:
    """Return the frame; for a status, ``params`` starts with the error byte."""
    body = stuff(bytes((instruction,)) + params)
    head, crc = _head(id_, len(body) + 2)
    return head + body + crc16(body, crc).to_bytes(2, "little")


@lru_cache(maxsize=1024)
def _head(id_: int, length: int) -> tuple[bytes, int]:
    """Compute a frame's first bytes and their CRC; cached, because most frames begin alike."""
    head = HEADER + bytes((id_, length & 0xFF, length >> 8))
    return head, crc16(head)


class Dynamixel2Reader(FrameReader):
    """Reads protocol 2.0 frames."""

    header = HEADER
    shortest = 7

    def _size(self, start: int) -> int | None:
        buffer = self._buffer
        if start + self.shortest > len(buffer):
            return None
        length = buffer[start + 5] | buffer[start + 6] << 8
        known = buffer[start + 4] not in (0xFD, 0xFF)
        return length + 7 if known and 3 <= length <= MAX_FRAME_BYTES else 0

    def _parse(self, raw: bytes, end: int) -> Frame | None:
        if crc16(raw[:-2]) != raw[-2] | raw[-1] << 8:
            return None
        return Frame(raw[4], raw[7], unstuff(raw[8:-2]), end, raw)

"""Dynamixel protocol 2.0 frames: ``FF FF FD 00 ID LEN16 INST … CRC16``, byte-stuffed."""

from __future__ import annotations

from array import array
from struct import unpack

from servosim.frames.reader import Frame, FrameReader

__all__ = ["Dynamixel2Reader", "crc16", "encode2", "stuff", "unstuff"]

HEADER = b"\xff\xff\xfd\x00"
POLYNOMIAL = 0x8005  # CRC-16/BUYPASS, e-manual "protocol 2.0, CRC calculation"
LONGEST = 1024  # LEN of a longer frame is taken for a false header


def _crc_row(byte: int) -> int:
    crc = byte << 8
    for _ in range(8):
        crc = (crc << 1) ^ POLYNOMIAL if crc & 0x8000 else crc << 1
    return crc & 0xFFFF


def _crc_pairs() -> array[int]:
    """Return the CRC of every two bytes, the first of them the high byte of the index."""
    last = [_crc_row(byte) for byte in range(256)]
    first = [(crc << 8) & 0xFFFF ^ last[crc >> 8] for crc in last]
    return array("H", [a ^ b for a in first for b in last])


_CRC = _crc_pairs()


def crc16(data: bytes) -> int:
    """Return the CRC of ``data``; a zero byte in front does not change it, so pairs will do."""
    if len(data) & 1:
        data = b"\x00" + data
    pairs: tuple[int, ...] = unpack(f">{len(data) // 2}H", data)
    crc, table = 0, _CRC
    for pair in pairs:
        crc = table[crc ^ pair]
    return crc


def stuff(body: bytes) -> bytes:
    """Put an FD behind every ``FF FF FD``, so that no header appears inside a frame."""
    return body.replace(b"\xff\xff\xfd", b"\xff\xff\xfd\xfd")


def unstuff(body: bytes) -> bytes:
    """Undo ``stuff``."""
    return body.replace(b"\xff\xff\xfd\xfd", b"\xff\xff\xfd")


def encode2(id_: int, instruction: int, params: bytes = b"") -> bytes:
    """Return the frame; for a status, ``params`` starts with the error byte."""
    body = stuff(bytes((instruction,)) + params)
    length = len(body) + 2
    frame = HEADER + bytes((id_, length & 0xFF, length >> 8)) + body
    return frame + crc16(frame).to_bytes(2, "little")


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
        return length + 7 if known and 3 <= length <= LONGEST else 0

    def _parse(self, raw: bytes, end: int) -> Frame | None:
        if crc16(raw[:-2]) != raw[-2] | raw[-1] << 8:
            return None
        return Frame(raw[4], raw[7], unstuff(raw[8:-2]), end, raw)

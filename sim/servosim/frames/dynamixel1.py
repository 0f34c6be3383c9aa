"""Dynamixel protocol 1.0 frames, which Feetech servos share: ``FF FF ID LEN INST … CHK``."""

from __future__ import annotations

from servosim.frames.reader import Frame, FrameReader

__all__ = ["Dynamixel1Reader", "checksum", "encode1"]


def checksum(body: bytes) -> int:
    """Return the inverted sum of everything between the header and the checksum."""
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

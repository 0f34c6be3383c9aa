"""Byte stuffing of Dynamixel protocol 2.0: no packet's inside looks like a header."""

from __future__ import annotations

__all__ = ["stuffed", "unstuffed"]

_HEADER = b"\xff\xff\xfd"
_MARK = 0xFD


def stuffed(inside: bytes) -> bytes:
    """Put an FD behind each FF FF FD between the length field and the CRC."""
    return inside.replace(_HEADER, _HEADER + bytes((_MARK,)))


def unstuffed(inside: bytes) -> bytes:
    """Take away the one FD behind each FF FF FD.

    The SDK's own ``removeStuffing`` looks for FF FF FD FD in what it has not yet unstuffed and
    loses a byte of ``FF FF FD FF FD FD`` and its like (D2).
    """
    return inside.replace(_HEADER + bytes((_MARK,)), _HEADER)

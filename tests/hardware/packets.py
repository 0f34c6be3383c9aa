"""Packets of protocol 1 in hex, for scripts in which the literal bytes are not the point."""

from __future__ import annotations


def packet(servo_id: int, *body: int) -> str:
    """Return a packet with header, length and checksum around what it says."""
    inside = bytes((servo_id, len(body) + 1, *body))
    return (b"\xff\xff" + inside + bytes((~sum(inside) & 0xFF,))).hex(" ")


def asks(servo_id: int, address: int, size: int) -> str:
    """Return the question for some bytes of a servo's memory."""
    return packet(servo_id, 0x02, address, size)


def asks_all(servo_ids: list[int], address: int, size: int) -> str:
    """Return the sync read of some bytes of several servos' memories."""
    return packet(0xFE, 0x82, address, size, *servo_ids)


def says(servo_id: int, *data: int, error: int = 0) -> str:
    """Return a servo's answer."""
    return packet(servo_id, error, *data)

"""Protocol 1 packets in hex, for tests in which the exact bytes do not matter."""

from __future__ import annotations


def packet(servo_id: int, *body: int) -> str:
    """Return a packet: the body with header, length and checksum."""
    inside = bytes((servo_id, len(body) + 1, *body))
    return (b"\xff\xff" + inside + bytes((~sum(inside) & 0xFF,))).hex(" ")


def request(servo_id: int, address: int, size: int) -> str:
    """Return the read request for some bytes of a servo's memory."""
    return packet(servo_id, 0x02, address, size)


def sync_request(servo_ids: list[int], address: int, size: int) -> str:
    """Return the sync read of some bytes of several servos' memories."""
    return packet(0xFE, 0x82, address, size, *servo_ids)


def reply(servo_id: int, *data: int, error: int = 0) -> str:
    """Return a servo's status packet."""
    return packet(servo_id, error, *data)

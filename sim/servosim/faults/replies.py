"""Faults of answers: each takes the bytes of a reply and says what reaches the host, and when."""

from __future__ import annotations

from collections.abc import Callable
from random import Random

from servosim.faults.fault import Fault

__all__ = ["LOST", "REPLIES", "Arrival"]

Arrival = tuple[float, bytes]  # delay behind the moment at which it was due [s], bytes

LOST = "lost"  # the host's instruction does not come through


def _silent(_: bytes, __: Fault, ___: Random) -> list[Arrival]:
    return []


def _late(data: bytes, fault: Fault, _: Random) -> list[Arrival]:
    return [(fault.delay_s, data)]


def _short(data: bytes, fault: Fault, _: Random) -> list[Arrival]:
    return [(0.0, data[: fault.bytes])]


def _flipped(data: bytes, fault: Fault, random: Random) -> list[Arrival]:
    flipped = int.from_bytes(data, "little")
    for bit in random.sample(range(8 * len(data)), min(fault.bits, 8 * len(data))):
        flipped ^= 1 << bit
    return [(0.0, flipped.to_bytes(len(data), "little"))]


def _checksum(data: bytes, _: Fault, __: Random) -> list[Arrival]:
    return [(0.0, data[:-1] + bytes((data[-1] ^ 0xFF,)))]


def _garbage(data: bytes, fault: Fault, random: Random) -> list[Arrival]:
    return [(0.0, random.randbytes(fault.bytes) + data)]


def _truncated(data: bytes, _: Fault, random: Random) -> list[Arrival]:
    return [(0.0, data[: random.randrange(len(data))])]


def _duplicated(data: bytes, fault: Fault, _: Random) -> list[Arrival]:
    return [(0.0, data), (fault.delay_s, data)]


REPLIES: dict[str, Callable[[bytes, Fault, Random], list[Arrival]]] = {
    "silent": _silent,  # no answer at all
    "late": _late,  # delay_s behind: it meets the next request
    "short": _short,  # only the first `bytes`
    "flipped": _flipped,  # `bits` of it, anywhere
    "checksum": _checksum,  # the last byte is wrong
    "garbage": _garbage,  # `bytes` of it before the header
    "truncated": _truncated,  # breaks off anywhere
    "duplicated": _duplicated,  # the same again delay_s behind
}

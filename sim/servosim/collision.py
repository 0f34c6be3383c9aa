"""Two servos speaking at once: a line that any of them can pull low, read by a UART."""

from __future__ import annotations

from collections.abc import Sequence

__all__ = ["collide"]

SAMPLES = 8  # of one bit
FRAME_BITS = 10  # start, eight data, stop


def collide(speeches: Sequence[tuple[float, bytes]], byte_s: float) -> tuple[float, bytes]:
    """Return what a receiver makes of bytes that overlap on a line where low wins.

    Args:
        speeches: Start [s] and bytes of everybody who speaks.
        byte_s: Time of one byte [s]; zero when the wire takes none.

    Returns:
        The start of the first speech and the bytes that a UART reads.
    """
    start_s = min(at_s for at_s, _ in speeches)
    if byte_s <= 0.0:
        return start_s, _overlay([data for _, data in speeches])
    sample_s = byte_s / (FRAME_BITS * SAMPLES)
    shifted = [(round((at_s - start_s) / sample_s), data) for at_s, data in speeches]
    return start_s, _receive(_line(shifted))


def _overlay(speeches: Sequence[bytes]) -> bytes:
    length = max(map(len, speeches))
    padded = [data.ljust(length, b"\xff") for data in speeches]
    mixed = bytearray(padded[0])
    for data in padded[1:]:
        mixed = bytearray(a & b for a, b in zip(mixed, data, strict=True))
    return bytes(mixed)


def _line(shifted: Sequence[tuple[int, bytes]]) -> list[bool]:
    end = max(at + len(data) * FRAME_BITS * SAMPLES for at, data in shifted)
    levels = [True] * (end + FRAME_BITS * SAMPLES)
    for start, data in shifted:
        for position, byte in enumerate(data):
            bits = byte << 1 | 1 << 9  # start bit low, least significant first, stop bit high
            for k in range(FRAME_BITS):
                if not bits >> k & 1:
                    at = start + (position * FRAME_BITS + k) * SAMPLES
                    levels[at : at + SAMPLES] = [False] * SAMPLES
    return levels


def _receive(levels: Sequence[bool]) -> bytes:
    received = bytearray()
    at, middle = 0, SAMPLES // 2
    last = len(levels) - FRAME_BITS * SAMPLES
    while at < last:
        if levels[at]:
            at += 1
            continue
        bits = [levels[at + middle + k * SAMPLES] for k in range(FRAME_BITS)]
        received.append(sum(bit << k for k, bit in enumerate(bits[1:9])))
        at += (FRAME_BITS - 1) * SAMPLES + middle
    return bytes(received)

"""Fast Sync Read of Dynamixel protocol 2.0: one packet in which each servo speaks in turn.

``FF FF FD 00 FE LEN 55 | ERR ID data CRC | ERR ID data CRC | …`` is, seen from outside, one
status packet of id 0xFE whose data hold the inner checksums; nothing in it is stuffed.
"""

from __future__ import annotations

from collections.abc import Sequence

from ikservo.hardware.packets.dialect import Frame

__all__ = ["combined_size", "split"]

_AROUND = 4  # ERR, ID and CRC around each servo's data


def combined_size(count: int, size: int) -> int:
    """Return the data bytes of the combined packet: without its first ERR and its last CRC."""
    return count * (size + _AROUND) - 3


def split(said: bytes, servo_ids: Sequence[int], size: int) -> list[Frame]:
    """Return what each servo said; nothing, if they did not speak in the order they were asked.

    Args:
        said: From the first ERR to the last data byte; one checksum covers all of it.
        servo_ids: Who was asked, in order.
        size: Bytes of each servo's data.
    """
    parts = [said[at : at + size + 2] for at in range(0, len(said), size + _AROUND)]
    if [part[1] for part in parts] != list(servo_ids):
        return []
    return [Frame(part[1], part[0], part[2:]) for part in parts]

"""The SDK's packet handler for protocol 2.0, its stuffing put right and its CRC made quick."""

# The camelCase names are the SDK's: it calls them.
# ruff: noqa: N802

from __future__ import annotations

from collections.abc import Sequence

from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler

from ikservo.hardware.packets.protocol_2 import crc
from ikservo.hardware.packets.stuffing import stuffed, unstuffed

__all__ = ["PacketHandler"]

_LEN, _INSIDE = 5, 7  # where the length field and the instruction stand


class PacketHandler(Protocol2PacketHandler):
    """The SDK's packet handler with its stuffing put right (D1, D2)."""

    def addStuffing(self, packet: list[int]) -> list[int]:
        """Stuff in place: ``txPacket`` does not look at what this returns."""
        inside = stuffed(bytes(packet[_INSIDE:-2]))
        packet[_LEN:] = [*(len(inside) + 2).to_bytes(2, "little"), *inside, 0, 0]
        return packet

    def removeStuffing(self, packet: list[int]) -> list[int]:
        """Unstuff in place."""
        inside = unstuffed(bytes(packet[_INSIDE:-2]))
        packet[_LEN:-2] = [*(len(inside) + 2).to_bytes(2, "little"), *inside]
        return packet

    def updateCRC(self, crc_accum: int, data_blk_ptr: Sequence[int], data_blk_size: int) -> int:
        """Return the SDK's own CRC, which it computes with a table made anew for each packet."""
        return crc(crc_accum, data_blk_ptr, data_blk_size)

"""The two ways to write a packet, as far as asking who is there needs them.

Feetech servos and Dynamixel protocol 1.0 share one framing, so that one ping finds both; protocol
2.0 has its own.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from ikservo.hardware.packets import protocol_1
from ikservo.hardware.packets.dialect import Heard
from ikservo.registers import MODELS, Family

__all__ = ["FRAMINGS", "Framing", "framing_of"]

_PING = 0x01


class _Dialect(Protocol):
    """How one framing is written and read."""

    def ping(self, servo_id: int) -> bytes: ...
    def scan(self, heard: bytes, *, final: bool) -> Heard: ...


@dataclass(frozen=True, slots=True)
class Framing:
    """One way to write packets.

    Attributes:
        name: For messages.
        families: The dialects that use it.
        ids: Which ids a servo can have.
        ping_bytes: Length of the question.
        answer_bytes: Length of the answer.
    """

    name: str
    families: tuple[Family, ...]
    ids: range
    ping_bytes: int
    answer_bytes: int

    @property
    def baud_rates(self) -> frozenset[int]:
        """Return every rate that a known model of these families can be set to."""
        tables = [table for table in MODELS.values() if table.family in self.families]
        return frozenset(rate for table in tables for rate in table.baud_rates.values())

    def dialect(self) -> _Dialect:
        """Return what writes and reads it; the vendor's SDK is imported only now."""
        return _Two() if Family.DYNAMIXEL_2 in self.families else _One()


FRAMINGS = (
    Framing(
        "Feetech and Dynamixel 1.0",
        (Family.FEETECH_STS, Family.FEETECH_SCS, Family.DYNAMIXEL_1),
        ids=range(254),
        ping_bytes=6,
        answer_bytes=6,
    ),
    Framing("Dynamixel 2.0", (Family.DYNAMIXEL_2,), ids=range(253), ping_bytes=10, answer_bytes=14),
)


def framing_of(family: Family) -> Framing:
    """Return the framing that a family uses."""
    return next(framing for framing in FRAMINGS if family in framing.families)


class _Sheet:
    """Takes a packet down where the vendors' handlers think they send it.

    Really sending it through them would discard what earlier servos have just answered (they
    clear the input first), and pings are sent while answers to others are still under way.
    """

    is_using = False
    packet = b""

    def clearPort(self) -> None:  # noqa: N802 (the SDKs call it)
        pass

    def writePort(self, packet: Sequence[int]) -> int:  # noqa: N802 (the SDKs call it)
        self.packet = bytes(packet)
        return len(packet)


class _One:
    def __init__(self) -> None:
        from scservo_sdk.protocol_packet_handler import protocol_packet_handler  # noqa: PLC0415

        self._handler = protocol_packet_handler()

    def ping(self, servo_id: int) -> bytes:
        sheet = _Sheet()
        self._handler.txPacket(sheet, [0, 0, servo_id, 2, _PING, 0])
        return sheet.packet

    def scan(self, heard: bytes, *, final: bool) -> Heard:
        return protocol_1.scan(heard, (0,), final=final)


class _Two:
    def __init__(self) -> None:
        from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler  # noqa: PLC0415
        from dynamixel_sdk.robotis_def import COMM_TX_ERROR  # noqa: PLC0415

        from ikservo.hardware.packets.protocol_2 import Answers  # noqa: PLC0415

        self._handler = Protocol2PacketHandler()
        self._answers = Answers(COMM_TX_ERROR)

    def ping(self, servo_id: int) -> bytes:
        sheet = _Sheet()
        self._handler.txPacket(sheet, [0, 0, 0, 0, servo_id, 3, 0, _PING, 0, 0])
        return sheet.packet

    def scan(self, heard: bytes, *, final: bool) -> Heard:
        return self._answers.scan(heard, (3,), final=final)

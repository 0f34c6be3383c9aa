"""Protocol-neutral packets: status packets, replies and their faults, memory ranges, codecs."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Protocol

__all__ = [
    "BROADCAST_ID",
    "LONGEST_RETURN_DELAY_S",
    "FaultKind",
    "MemoryRange",
    "PacketCodec",
    "Reply",
    "ReplyFault",
    "ScanResult",
    "Status",
    "StatusPacket",
]


@dataclass(frozen=True, slots=True)
class Status:
    """A valid status packet.

    Attributes:
        servo_id: Who answered.
        data: The parameters, exactly as many bytes as were asked for.
        alarm_bits: The servo's complaint about itself; the data are valid all the same.
        doubtful: It cannot be told from the answer to an earlier question.
    """

    servo_id: int
    data: bytes = b""
    alarm_bits: int = 0
    doubtful: bool = False


class FaultKind(Enum):
    """Why a question has no answer."""

    SILENT = "silent"
    GARBLED = "garbled"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class ReplyFault:
    """The reason why a servo's answer is missing.

    Attributes:
        servo_id: Who was asked.
        kind: Silent, garbled or refused.
        found: What happened, to stand behind the servo's name: "does not answer".
        alarm_bits: What a refusing servo complained about besides.
        sent: The question.
        received: Everything that was heard.
    """

    servo_id: int
    kind: FaultKind
    found: str
    alarm_bits: int = 0
    sent: bytes = b""
    received: bytes = b""


Reply = Status | ReplyFault


@dataclass(frozen=True, slots=True)
class MemoryRange:
    """A stretch of a servo's memory.

    Attributes:
        address: First byte.
        size: Bytes.
    """

    address: int
    size: int

    @property
    def end(self) -> int:
        """Return the first address behind it."""
        return self.address + self.size

    def overlaps(self, other: MemoryRange) -> bool:
        """Return whether the two have a byte in common."""
        return self.address < other.end and other.address < self.end

    def grown(self, by: int) -> MemoryRange:
        """Return a window of ``by`` bytes more around it.

        It grows towards lower addresses, where there is always memory, and upwards only from the
        very beginning of the table.
        """
        below = min(by, self.address)
        return MemoryRange(self.address - below, self.size + by)

    def extract(self, reply: Reply, window: MemoryRange) -> Reply:
        """Return what the answer for a window says about this stretch."""
        if window == self or isinstance(reply, ReplyFault):
            return reply
        start = self.address - window.address
        return replace(reply, data=reply.data[start : start + self.size])


BROADCAST_ID = 0xFE
"""The id that every servo listens to, of both vendors and in both protocols."""

LONGEST_RETURN_DELAY_S = 254 * 2e-6
"""The longest delay before an answer that any servo's register can hold."""


@dataclass(frozen=True, slots=True)
class StatusPacket:
    """A status packet whose checksum is right.

    Attributes:
        servo_id: Who says it.
        error: The error byte.
        data: The parameters.
    """

    servo_id: int
    error: int
    data: bytes


@dataclass(frozen=True, slots=True)
class ScanResult:
    """What a dialect makes of the bytes so far.

    Attributes:
        frames: Status packets whose checksums are right, in order.
        pending: Bytes at the end that may be the beginning of another.
        junk: Bytes that belong to no packet.
    """

    frames: tuple[StatusPacket, ...]
    pending: int
    junk: int


class PacketCodec(Protocol):
    """How one protocol writes a status packet."""

    @property
    def too_long(self) -> int:
        """Return the code by which the vendor's SDK says that a packet is too long to send."""
        ...

    def frame_size(self, size: int) -> int:
        """Return the bytes of a status packet with ``size`` bytes of data."""
        ...

    def scan(self, heard: bytes, sizes: Collection[int], *, final: bool) -> ScanResult:
        """Find the status packets.

        Args:
            heard: The bytes so far.
            sizes: Bytes of data in the answers that are hoped for.
            final: No more bytes will come.
        """
        ...

    def parse_in_order(self, heard: bytes, sizes: Mapping[int, int]) -> dict[int, Reply] | None:
        """Return the answers, if the bytes are those of healthy servos in order and nothing else.

        This is the quick way for a line on which all is well; ``scan`` makes sense of the rest.

        Args:
            heard: As many bytes as the answers have.
            sizes: Who answers, in order, and how many bytes of data each.
        """
        ...

    def interpret(self, frame: StatusPacket, size: int) -> Reply | None:
        """Return what a frame says to a question for ``size`` bytes; None if it is no answer."""
        ...

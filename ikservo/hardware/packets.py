"""Protocol-neutral packets: status packets, replies and their faults, memory ranges, codecs."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from typing import Protocol


@dataclass(frozen=True, slots=True)
class Status:
    """A valid status packet.

    Attributes:
        servo_id: The sender.
        data: The parameters, exactly the requested number of bytes.
        alarm_bits: The alarms that the servo reports; the data are still valid.
        ambiguous: Whether the packet cannot be distinguished from the reply to an earlier request.
    """

    servo_id: int
    data: bytes = b""
    alarm_bits: int = 0
    ambiguous: bool = False


class FaultKind(Enum):
    """The reason why a request has no usable reply."""

    SILENT = "silent"
    GARBLED = "garbled"
    REFUSED = "refused"


@dataclass(frozen=True, slots=True)
class ReplyFault:
    """The reason why a servo's reply is missing.

    Attributes:
        servo_id: The receiver of the request.
        kind: Silent, garbled or refused.
        found: Text that follows the servo's name in a message: "does not answer".
        alarm_bits: The alarms reported by a servo that refuses.
        sent: The request.
        received: Everything that was received.
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
    """A range of a servo's memory: ``size`` bytes from ``address`` on."""

    address: int
    size: int

    @property
    def end(self) -> int:
        """First address after the range."""
        return self.address + self.size

    def overlaps(self, other: MemoryRange) -> bool:
        """Check whether the two ranges have a byte in common."""
        return (
            self.address < other.address + other.size and other.address < self.address + self.size
        )

    def grown(self, by: int) -> MemoryRange:
        """Return a window that is ``by`` bytes larger than the range.

        The window grows towards lower addresses, which always exist; it grows upwards only if the
        range is at the very beginning of the table.
        """
        below = min(by, self.address)
        return MemoryRange(self.address - below, self.size + by)

    def extract(self, reply: Reply, window: MemoryRange) -> Reply:
        """Extract this range's part of the reply for a window."""
        if window == self or isinstance(reply, ReplyFault):
            return reply
        start = self.address - window.address
        return replace(reply, data=reply.data[start : start + self.size])


BROADCAST_ID = 0xFE
"""The broadcast id, the same for both vendors and both protocols."""

MAX_RETURN_DELAY_S = 254 * 2e-6
"""The longest return delay that any servo's register can hold, seconds."""


@dataclass(frozen=True, slots=True)
class StatusPacket:
    """A status packet whose checksum is correct: its sender, error byte and parameters."""

    servo_id: int
    error: int
    data: bytes


@dataclass(frozen=True, slots=True)
class ScanResult:
    """Result of scanning the bytes received so far.

    Attributes:
        frames: Status packets whose checksums are correct, in order.
        pending: Bytes at the end that may be the beginning of another packet.
        junk: Bytes that belong to no packet.
    """

    frames: tuple[StatusPacket, ...]
    pending: int
    junk: int


class PacketCodec(Protocol):
    """Codec for the packets of one protocol."""

    @property
    def too_long(self) -> int:
        """The vendor SDK's result code for a packet that is too long to send."""
        ...

    def encode_words(self, *numbers: int) -> bytes:
        """Encode addresses and sizes."""
        ...

    def instruct(self, servo_id: int, instruction: int, parameters: bytes) -> list[int]:
        """Build an instruction packet; the SDK fills in what it computes itself, here 0."""
        ...

    def frame_size(self, size: int) -> int:
        """Return the number of bytes in a status packet with ``size`` bytes of data."""
        ...

    def scan(self, data: bytes, sizes: Collection[int], *, final: bool) -> ScanResult:
        """Find status packets of the expected data sizes; ``final``: no more bytes will arrive."""
        ...

    def parse_in_order(self, data: bytes, sizes: Mapping[int, int]) -> dict[int, Reply] | None:
        """Parse the bytes if they are exactly the expected replies, without errors and in order.

        This is the fast path for a healthy line; ``scan`` handles everything else. ``sizes`` are
        bytes of data by servo id, in the order of the replies.
        """
        ...

    def interpret(self, frame: StatusPacket, size: int) -> Reply | None:
        """Interpret a frame as the reply to a request for ``size`` bytes; else return None."""
        ...

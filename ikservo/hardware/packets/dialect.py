"""How a protocol writes a status packet: what an exchange needs to know of it."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Protocol

from ikservo.hardware.packets.replies import Reply

__all__ = ["BROADCAST_ID", "LONGEST_RETURN_DELAY_S", "Dialect", "Frame", "Heard"]

BROADCAST_ID = 0xFE
"""The id that every servo listens to, of both vendors and in both protocols."""

LONGEST_RETURN_DELAY_S = 254 * 2e-6
"""The longest delay before an answer that any servo's register can hold."""


@dataclass(frozen=True, slots=True)
class Frame:
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
class Heard:
    """What a dialect makes of the bytes so far.

    Attributes:
        frames: Status packets whose checksums are right, in order.
        pending: Bytes at the end that may be the beginning of another.
        junk: Bytes that belong to no packet.
    """

    frames: tuple[Frame, ...]
    pending: int
    junk: int


class Dialect(Protocol):
    """How one protocol writes a status packet."""

    @property
    def too_long(self) -> int:
        """Return the code by which the vendor's SDK says that a packet is too long to send."""
        ...

    def frame_size(self, size: int) -> int:
        """Return the bytes of a status packet with ``size`` bytes of data."""
        ...

    def scan(self, heard: bytes, sizes: Collection[int], *, final: bool) -> Heard:
        """Find the status packets.

        Args:
            heard: The bytes so far.
            sizes: Bytes of data in the answers that are hoped for.
            final: No more bytes will come.
        """
        ...

    def in_order(self, heard: bytes, sizes: Mapping[int, int]) -> dict[int, Reply] | None:
        """Return the answers, if the bytes are those of healthy servos in order and nothing else.

        This is the quick way for a line on which all is well; ``scan`` makes sense of the rest.

        Args:
            heard: As many bytes as the answers have.
            sizes: Who answers, in order, and how many bytes of data each.
        """
        ...

    def judge(self, frame: Frame, size: int) -> Reply | None:
        """Return what a frame says to a question for ``size`` bytes; None if it is no answer."""
        ...

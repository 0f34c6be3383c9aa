"""A stretch of a servo's memory, and the wider window through which it may be read."""

from __future__ import annotations

from dataclasses import dataclass, replace

from ikservo.hardware.packets.replies import Fault, Reply

__all__ = ["Span"]


@dataclass(frozen=True, slots=True)
class Span:
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

    def meets(self, other: Span) -> bool:
        """Return whether the two have a byte in common."""
        return self.address < other.end and other.address < self.end

    def widened(self, by: int) -> Span:
        """Return a window of ``by`` bytes more around it.

        It grows towards lower addresses, where there is always memory, and upwards only from the
        very beginning of the table.
        """
        below = min(by, self.address)
        return Span(self.address - below, self.size + by)

    def cut(self, reply: Reply, window: Span) -> Reply:
        """Return what the answer for a window says about this stretch."""
        if window == self or isinstance(reply, Fault):
            return reply
        start = self.address - window.address
        return replace(reply, data=reply.data[start : start + self.size])

"""What every protocol driver can do; above it nobody knows which vendor's SDK speaks."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Protocol

from ikservo.hardware.finding.roll_call import RollCall
from ikservo.hardware.packets.exchange import Exchange
from ikservo.hardware.packets.replies import Reply
from ikservo.hardware.packets.span import Span

__all__ = ["Driver"]


class Driver(Protocol):
    """One protocol on one port.

    Addresses and bytes go in, replies come out. A servo that does not answer is a ``Fault``
    among the replies; only a lost port raises.
    """

    @property
    def exchange(self) -> Exchange:
        """Return how questions are put and heard out; it knows the servos' return delay."""
        ...

    def set_return_delay(self, return_delay_s: float) -> None:
        """Wait no longer than this before each answer, seconds."""
        ...

    @property
    def can_sync_read(self) -> bool:
        """Whether one question can be put to many servos for the same bytes."""
        ...

    def can_bulk_read(self, servo_ids: Iterable[int], /) -> bool:
        """Whether one question can be put to these servos, each for its own bytes."""
        ...

    @property
    def repeated_itself(self) -> bool:
        """Whether the latest reading of many was put a second time already, in another way."""
        ...

    @property
    def can_bulk_write(self) -> bool:
        """Whether one packet can tell many servos, each at its own address."""
        ...

    def ping(self, servo_id: int) -> Reply:
        """Ask whether a servo is there; the data are what the protocol's ping tells."""
        ...

    def roll_call(self, highest_id: int) -> RollCall:
        """Ask everybody up to an id whether they are there."""
        ...

    def read(self, servo_id: int, address: int, size: int) -> Reply:
        """Ask one servo for ``size`` bytes."""
        ...

    def write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Write to one servo and hear whether it took it."""
        ...

    def sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, Reply]:
        """Ask many servos for the same bytes; each has its own reply."""
        ...

    def bulk_read(self, spans: Mapping[int, Span]) -> dict[int, Reply]:
        """Ask many servos, each for its own bytes."""
        ...

    def sync_write(self, address: int, data: Mapping[int, bytes]) -> None:
        """Write to many servos at once; the protocols give no answer to this."""
        ...

    def bulk_write(self, rows: Mapping[int, tuple[int, bytes]]) -> None:
        """Write to many servos at once, each to its own address; without an answer."""
        ...

    def reg_write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Lay a write ready that ``action`` sets off."""
        ...

    def action(self) -> None:
        """Set off what ``reg_write`` laid ready, on every servo at the same moment."""
        ...

    def reboot(self, servo_id: int) -> Reply:
        """Restart one servo; its torque is lost."""
        ...

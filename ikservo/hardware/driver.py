"""The interface of a protocol driver, and the broadcast ping."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from ikservo.hardware.packets import MemoryRange, Reply, ScanResult, Status, StatusPacket
from ikservo.hardware.transceiver import Transceiver

__all__ = ["BroadcastPingResult", "ProtocolDriver", "broadcast_ping"]


_SLOT_BYTES = 14  # the longest answer to a ping
_MAX_PAUSE_S = 0.003  # the most that a servo keeps from the one before it
_MARGIN = 2.0  # times the pace at which servos have answered so far


@dataclass(frozen=True, slots=True)
class BroadcastPingResult:
    """Who answered.

    Attributes:
        answers: Every answer by id; two of one id are two servos, or one answer doubled.
        junk: Bytes that belong to no answer: noise, or several servos speaking at once.
    """

    answers: Mapping[int, tuple[Status, ...]]
    junk: int


def broadcast_ping(
    exchange: Transceiver, send: Callable[[], int], size: int, highest_id: int
) -> BroadcastPingResult:
    """Send a broadcast ping and listen until nobody up to an id can still answer.

    Servos answer in the order of their ids, each in its slot. The SDK's own always waits for 253
    slots of 3 ms, busily (D13). Here the wait ends with the slot of the highest id, and the first
    answers tell how long a slot is.

    Raises:
        PortLostError: The line is gone.
    """
    port = exchange.port
    raw, heard = bytearray(), ScanResult((), 0, 0)
    with port.exchange():
        exchange.send(send)
        started_s = port.clock.now_s()
        slot_s = port.wire_s(_SLOT_BYTES) + _MAX_PAUSE_S
        while True:
            end_s = started_s + exchange.return_delay_s + (highest_id + 1) * slot_s
            chunk = port.read_until(1 + port.getBytesAvailable(), end_s + port.patience.timeout_s)
            if not chunk:
                break
            raw += chunk
            heard = _scan_replies(exchange, raw, size, final=False)
            if heard.frames:
                took_s = port.clock.now_s() - started_s
                slot_s = min(slot_s, _MARGIN * took_s / (heard.frames[-1].servo_id + 1))
    heard = _scan_replies(exchange, raw, size, final=True)
    return BroadcastPingResult(_collect_statuses(exchange, heard.frames, size), heard.junk)


def _scan_replies(exchange: Transceiver, raw: bytearray, size: int, *, final: bool) -> ScanResult:
    return exchange.dialect.scan(bytes(raw).removeprefix(exchange.port.sent), (size,), final=final)


def _collect_statuses(
    exchange: Transceiver, frames: Iterable[StatusPacket], size: int
) -> dict[int, tuple[Status, ...]]:
    answers: dict[int, tuple[Status, ...]] = {}
    for frame in frames:
        reply = exchange.dialect.interpret(frame, size)
        if isinstance(reply, Status):
            answers[reply.servo_id] = (*answers.get(reply.servo_id, ()), reply)
    return answers


class ProtocolDriver(Protocol):
    """One protocol on one port.

    Addresses and bytes go in, replies come out. A servo that does not answer is a ``Fault``
    among the replies; only a lost port raises.
    """

    @property
    def transceiver(self) -> Transceiver:
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
    def already_retried(self) -> bool:
        """Whether the latest reading of many was put a second time already, in another way."""
        ...

    @property
    def can_bulk_write(self) -> bool:
        """Whether one packet can tell many servos, each at its own address."""
        ...

    def ping(self, servo_id: int) -> Reply:
        """Ask whether a servo is there; the data are what the protocol's ping tells."""
        ...

    def broadcast_ping(self, highest_id: int) -> BroadcastPingResult:
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

    def bulk_read(self, spans: Mapping[int, MemoryRange]) -> dict[int, Reply]:
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

"""The interface of a protocol driver, and the broadcast ping."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

from ikservo.hardware.packets import MemoryRange, Reply, ScanResult, Status
from ikservo.hardware.protocols.transceiver import Transceiver

_SLOT_BYTES = 14  # length of the longest ping reply
_MAX_PAUSE_S = 0.003  # maximum delay of a servo's reply after the previous servo's slot
_MARGIN = 2.0  # multiple of the measured time per slot


@dataclass(frozen=True, slots=True)
class BroadcastPingResult:
    """The replies to a broadcast ping.

    Attributes:
        replies: All replies by id; two replies from one id mean two servos, or a doubled reply.
        junk: Bytes that belong to no reply: noise, or several servos sending at once.
    """

    replies: Mapping[int, tuple[Status, ...]]
    junk: int


def broadcast_ping(
    exchange: Transceiver, send: Callable[[], int], size: int, highest_id: int
) -> BroadcastPingResult:
    """Send a broadcast ping and receive until no servo up to an id can still reply.

    Servos reply in the order of their ids, each in its slot. The SDK always waits for 253 slots of
    3 ms in a busy loop (docs/sdk-defects.md D13). Here the wait ends with the slot of the highest
    id, and the first replies show the length of a slot.

    Raises:
        PortLostError: The port is lost.
    """
    port = exchange.port
    raw, scan = bytearray(), ScanResult((), 0, 0)
    with port.exchange():
        exchange.send(send)
        started_s = port.clock.now_s()
        slot_s = port.wire_s(_SLOT_BYTES) + _MAX_PAUSE_S
        while True:
            end_s = started_s + exchange.return_delay_s + (highest_id + 1) * slot_s
            chunk = port.read_until(
                1 + port.getBytesAvailable(), end_s + port.reply_timeout.timeout_s
            )
            if not chunk:
                break
            raw += chunk
            scan = _scan_replies(exchange, raw, size, final=False)
            if scan.frames:
                took_s = port.clock.now_s() - started_s
                slot_s = min(slot_s, _MARGIN * took_s / (scan.frames[-1].servo_id + 1))
    scan = _scan_replies(exchange, raw, size, final=True)
    replies: dict[int, tuple[Status, ...]] = {}
    for frame in scan.frames:
        reply = exchange.codec.interpret(frame, size)
        if isinstance(reply, Status):
            replies[reply.servo_id] = (*replies.get(reply.servo_id, ()), reply)
    return BroadcastPingResult(replies, scan.junk)


def _scan_replies(exchange: Transceiver, raw: bytearray, size: int, *, final: bool) -> ScanResult:
    return exchange.codec.scan(bytes(raw).removeprefix(exchange.port.sent), (size,), final=final)


class ProtocolDriver(Protocol):
    """Driver of one protocol on one port.

    Methods take addresses and bytes, and return replies. A servo that does not reply is a
    ``ReplyFault`` among the replies; only a lost port raises.
    """

    @property
    def transceiver(self) -> Transceiver:
        """The transceiver that sends requests and reads replies; it keeps the return delay."""
        ...

    def set_return_delay(self, return_delay_s: float) -> None:
        """Set the maximum return delay before each reply, seconds."""
        ...

    @property
    def can_sync_read(self) -> bool:
        """Whether one request can read the same bytes of many servos."""
        ...

    def can_bulk_read(self, servo_ids: Iterable[int], /) -> bool:
        """Check whether one request can read different bytes of each of these servos."""
        ...

    @property
    def already_retried(self) -> bool:
        """Whether the latest group read has already been repeated with another instruction."""
        ...

    @property
    def can_bulk_write(self) -> bool:
        """Whether one packet can write to many servos, each at its own address."""
        ...

    def ping(self, servo_id: int) -> Reply:
        """Ping a servo; return the data of the protocol's ping reply."""
        ...

    def broadcast_ping(self, highest_id: int) -> BroadcastPingResult:
        """Ping all ids up to the highest."""
        ...

    def read(self, servo_id: int, address: int, size: int) -> Reply:
        """Read ``size`` bytes from one servo."""
        ...

    def write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Write to one servo and check its reply."""
        ...

    def sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, Reply]:
        """Read the same bytes from many servos; each sends its own reply."""
        ...

    def bulk_read(self, spans: Mapping[int, MemoryRange]) -> dict[int, Reply]:
        """Read different bytes from each of many servos."""
        ...

    def sync_write(self, address: int, data: Mapping[int, bytes]) -> None:
        """Write to many servos with one packet, to which they do not reply."""
        ...

    def bulk_write(self, rows: Mapping[int, tuple[int, bytes]]) -> None:
        """Write to many servos with one packet, each at its own address; they do not reply."""
        ...

    def reg_write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Prepare a write that ``action`` executes."""
        ...

    def action(self) -> None:
        """Execute the prepared writes of all servos at the same time."""
        ...

    def factory_reset(self, servo_id: int) -> Reply:
        """Give one servo its factory settings; its id stays."""
        ...

    def reboot(self, servo_id: int) -> Reply:
        """Restart one servo; its torque is off afterwards."""
        ...

"""The base of the protocol drivers, with the instructions that both protocols have."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from ikservo.hardware.packets import (
    BROADCAST_ID,
    MemoryRange,
    PacketCodec,
    Reply,
    ScanResult,
    Status,
)
from ikservo.hardware.port import Port
from ikservo.hardware.protocols.transceiver import RepeatedPackets, Transceiver

PING, READ, WRITE, REG_WRITE, ACTION, REBOOT = 0x01, 0x02, 0x03, 0x04, 0x05, 0x08
SYNC_READ, SYNC_WRITE, FAST_SYNC_READ, BULK_READ = 0x82, 0x83, 0x8A, 0x92
_REQUEST_INSTRUCTIONS = frozenset((READ, SYNC_READ, FAST_SYNC_READ, BULK_READ))

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


class ProtocolDriver(ABC):
    """Driver of one protocol on one port, with the instructions that all families support.

    Methods take addresses and bytes, and return replies. A servo that does not reply is a
    ``ReplyFault`` among the replies; only a lost port raises.

    Attributes:
        transceiver: The transceiver that sends requests and reads replies; it keeps the return
            delay.
        can_sync_read: Whether one request can read the same bytes of many servos.
        can_bulk_write: Whether one packet can write to many servos, each at its own address.
        already_retried: Whether the latest group read has already been repeated with another
            instruction.
        ping_size: Number of bytes of data in the reply to a ping; none in protocol 1.0
            (docs/sdk-defects.md F14).

    Args:
        port: The port.
        send: The vendor's ``txPacket``, which adds header and checksum to a packet.
        codec: The family's packet codec.
    """

    can_sync_read = can_bulk_write = already_retried = False
    ping_size = 0

    def __init__(
        self, port: Port, send: Callable[[Port, list[int]], int], codec: PacketCodec
    ) -> None:
        self._port, self._tx_packet = port, send
        self._repeated = RepeatedPackets(port, _REQUEST_INSTRUCTIONS)
        self.transceiver = Transceiver(port, codec)
        self._words = codec.encode_words

    def set_return_delay(self, return_delay_s: float) -> None:
        """Set the maximum return delay before each reply, seconds."""
        self.transceiver.return_delay_s = return_delay_s

    def can_bulk_read(self, servo_ids: Iterable[int]) -> bool:
        """Check whether one request can read different bytes of each of these servos."""
        return False

    def ping(self, servo_id: int) -> Reply:
        """Ping a servo; return the data of the protocol's ping reply."""
        return self._request_packet(servo_id, PING, b"", self.ping_size)

    def broadcast_ping(self, highest_id: int) -> BroadcastPingResult:
        """Ping all ids, and receive until no servo up to the highest id can still reply.

        Servos reply in the order of their ids, each in its slot. The SDK always waits for 253 slots
        of 3 ms in a busy loop (docs/sdk-defects.md D13). Here the wait ends with the slot of the
        highest id, and the first replies show the length of a slot.

        Raises:
            PortLostError: The port is lost.
        """
        port, exchange = self._port, self.transceiver
        raw, scan = bytearray(), ScanResult((), 0, 0)
        with port.exchange():
            exchange.send(lambda: self._send(BROADCAST_ID, PING, b""))
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
                scan = self._scan_ping_replies(raw, final=False)
                if scan.frames:
                    took_s = port.clock.now_s() - started_s
                    slot_s = min(slot_s, _MARGIN * took_s / (scan.frames[-1].servo_id + 1))
        scan = self._scan_ping_replies(raw, final=True)
        replies: dict[int, tuple[Status, ...]] = {}
        for frame in scan.frames:
            reply = exchange.codec.interpret(frame, self.ping_size)
            if isinstance(reply, Status):
                replies[reply.servo_id] = (*replies.get(reply.servo_id, ()), reply)
        return BroadcastPingResult(replies, scan.junk)

    def _scan_ping_replies(self, raw: bytearray, *, final: bool) -> ScanResult:
        data = bytes(raw).removeprefix(self._port.sent)
        return self.transceiver.codec.scan(data, (self.ping_size,), final=final)

    def read(self, servo_id: int, address: int, size: int) -> Reply:
        """Read ``size`` bytes from one servo."""
        span = MemoryRange(address, size)
        with self._port.lock:
            window = self.transceiver.choose_window((servo_id,), span)
            parameters = self._words(window.address, window.size)
            reply = self._request_packet(servo_id, READ, parameters, window.size, window)
        return span.extract(reply, window)

    def write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Write to one servo and check its reply."""
        self._port.pending.invalidate((servo_id,))
        return self._request_packet(servo_id, WRITE, self._words(address) + data)

    def sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, Reply]:
        """Read the same bytes from many servos; each sends its own reply.

        Without ``can_sync_read``, the servos are read one after the other.
        """
        if not self.can_sync_read:
            return {servo_id: self.read(servo_id, address, size) for servo_id in servo_ids}
        span = MemoryRange(address, size)
        with self._port.lock:
            window = self.transceiver.choose_window(tuple(servo_ids), span)
            parameters = self._words(window.address, window.size) + bytes(servo_ids)
            replies = self.transceiver.transact(
                lambda: self._send(BROADCAST_ID, SYNC_READ, parameters),
                dict.fromkeys(servo_ids, window.size),
                window,
            )
        if window is span:
            return replies
        return {servo_id: span.extract(reply, window) for servo_id, reply in replies.items()}

    def bulk_read(self, spans: Mapping[int, MemoryRange]) -> dict[int, Reply]:
        """Read different bytes from each servo, here one after the other."""
        return {i: self.read(i, span.address, span.size) for i, span in spans.items()}

    def sync_write(self, address: int, data: Mapping[int, bytes]) -> None:
        """Write to many servos with one packet, to which they do not reply."""
        size = len(next(iter(data.values())))
        rows = b"".join(bytes((servo_id, *row)) for servo_id, row in data.items())
        parameters = self._words(address, size) + rows
        self._port.pending.invalidate(data, MemoryRange(address, size))
        self.transceiver.transact(lambda: self._send(BROADCAST_ID, SYNC_WRITE, parameters))

    def bulk_write(self, rows: Mapping[int, tuple[int, bytes]]) -> None:
        """Write to many servos, each at its own address, here one write after the other."""
        for servo_id, (address, data) in rows.items():
            self.sync_write(address, {servo_id: data})

    def reg_write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Prepare a write that ``action`` executes."""
        return self._request_packet(servo_id, REG_WRITE, self._words(address) + data)

    def action(self) -> None:
        """Execute the prepared writes of all servos at once; a single servo would reply (D10)."""
        self._port.pending.invalidate(range(BROADCAST_ID))
        self.transceiver.transact(lambda: self._send(BROADCAST_ID, ACTION, b""))

    @abstractmethod
    def factory_reset(self, servo_id: int) -> Reply:
        """Give one servo its factory settings; its id stays."""

    def reboot(self, servo_id: int) -> Reply:
        """Restart one servo; its torque is off afterwards. Old AX servos do not support this."""
        self._port.pending.invalidate((servo_id,))
        return self._request_packet(servo_id, REBOOT, b"")

    def _request_packet(
        self,
        servo_id: int,
        instruction: int,
        parameters: bytes,
        size: int = 0,
        window: MemoryRange | None = None,
    ) -> Reply:
        replies = self.transceiver.transact(
            lambda: self._send(servo_id, instruction, parameters), {servo_id: size}, window
        )
        return replies[servo_id]

    def _send(self, servo_id: int, instruction: int, parameters: bytes) -> int:
        """Send a packet, through the vendor's SDK if it is new; return the SDK's result code."""
        key = (servo_id, instruction, parameters)
        if (result := self._repeated.send(key)) is not None:
            return result
        packet = self.transceiver.codec.instruct(*key)
        return self._repeated.record_sent(key, self._tx_packet(self._port, packet))

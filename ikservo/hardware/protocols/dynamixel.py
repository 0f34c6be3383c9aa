"""Dynamixel drivers for protocols 1.0 and 2.0, on the vendor's SDK.

The SDK builds and sends every packet through ``txPacket``, which is the same in 3.7.31 and in
4.1.0. Defects are numbered as in docs/sdk-defects.md (D11). Byte stuffing, which the SDK computes
and then discards, is corrected on sending (D1). The SDK's reception is not used, because it loses a
byte of some stuffed replies (D2), returns the CRC as data if a servo has refused (D3), and drops
the alarms of servos in sync reads (D4, D5).

Packets of protocol 1.0 go through ``Protocol1PacketHandler.txPacket``. The reception of this
handler is not used either: it returns the checksum as data if a servo has refused (D3), and waits
in a busy loop by the wall clock (D7).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

from ikservo.hardware.packets import (
    BROADCAST_ID,
    FaultKind,
    MemoryRange,
    Reply,
    ReplyFault,
    Status,
    StatusPacket,
)
from ikservo.hardware.port import Port
from ikservo.hardware.protocols.driver import BULK_READ, FAST_SYNC_READ, ProtocolDriver
from ikservo.hardware.protocols.protocol1 import Protocol1Codec
from ikservo.hardware.protocols.protocol2 import (
    FastSyncCodec,
    FixedPacketHandler,
    Protocol2Codec,
    fast_sync_size,
    split_fast_sync,
)
from ikservo.hardware.protocols.transceiver import Transceiver
from ikservo.hardware.vendor_modules import importing_from

with importing_from("dynamixel-sdk", "dynamixel_sdk"):
    from dynamixel_sdk.protocol1_packet_handler import Protocol1PacketHandler
    from dynamixel_sdk.robotis_def import COMM_TX_ERROR

_FACTORY_RESET, _BULK_WRITE = 0x06, 0x93
_KEEP_ID_AND_RATE = b"\x02"
_FAST_FAILURES = 2  # failures in succession; causes: old firmware, a missing servo, a bad line
_RETRY_FAST_AFTER = 200  # number of readings after which fast sync read is tried again


class DynamixelDriver(ProtocolDriver):
    """Driver for X-series servos and all others that use protocol 2.0.

    Groups are read by fast sync read, which saves a third of the wire time, until it fails twice in
    succession for the same servos (D5: a missing servo suppresses all replies). After that, and
    whenever it fails, they are read by sync read.
    """

    can_sync_read = can_bulk_write = True
    ping_size = 3  # model number (2 bytes) and firmware

    def __init__(self, port: Port, *, fast: bool = True) -> None:
        self._codec = Protocol2Codec(COMM_TX_ERROR)
        super().__init__(port, FixedPacketHandler().txPacket, self._codec)
        self._combined = Transceiver(port, FastSyncCodec(COMM_TX_ERROR))
        self._fast, self._fast_failures = fast, dict[tuple[int, ...], int]()
        self.already_retried = False

    def set_return_delay(self, return_delay_s: float) -> None:
        """Set the maximum return delay before each reply, seconds."""
        for exchange in (self.transceiver, self._combined):
            exchange.return_delay_s = return_delay_s

    def can_bulk_read(self, servo_ids: Iterable[int]) -> bool:
        """Check whether one request can read different bytes of each of these servos."""
        return True

    def sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, Reply]:
        """Read the same bytes from many servos; each sends its own reply."""
        span, ids = MemoryRange(address, size), tuple(servo_ids)
        with self._port.lock:
            failures = self._fast_failures.get(ids, 0)
            is_due = failures < _FAST_FAILURES or failures % _RETRY_FAST_AFTER == 0
            self.already_retried = self._fast and len(ids) > 1 and is_due
            replies = self._fast_sync_read(ids, span) if self.already_retried else {}
            if replies:
                self._fast_failures.pop(ids, None)
                self.already_retried = False
                return replies
            self._fast_failures[ids] = failures + 1
            return super().sync_read(ids, address, size)

    def _fast_sync_read(self, servo_ids: tuple[int, ...], span: MemoryRange) -> dict[int, Reply]:
        """Return every servo's reply, or nothing if fast sync read failed."""
        count = len(servo_ids)
        window = self._combined.choose_window(
            (BROADCAST_ID,), span, lambda size: fast_sync_size(count, size)
        )
        parameters = self._words(window.address, window.size) + bytes(servo_ids)
        reply = self._combined.transact(
            lambda: self._send(BROADCAST_ID, FAST_SYNC_READ, parameters),
            {BROADCAST_ID: fast_sync_size(count, window.size)},
            window,
        )[BROADCAST_ID]
        frames = (
            []
            if isinstance(reply, ReplyFault)
            else split_fast_sync(reply.data, servo_ids, window.size)
        )
        replies = {frame.servo_id: self._codec.interpret(frame, window.size) for frame in frames}
        return {i: span.extract(reply, window) for i, reply in replies.items() if reply}

    def bulk_read(self, spans: Mapping[int, MemoryRange]) -> dict[int, Reply]:
        """Read different bytes from each of many servos."""
        with self._port.lock:
            windows = {i: self.transceiver.choose_window((i,), span) for i, span in spans.items()}
            rows = (bytes((i,)) + self._words(w.address, w.size) for i, w in windows.items())
            parameters = b"".join(rows)
            replies = self.transceiver.transact(
                lambda: self._send(BROADCAST_ID, BULK_READ, parameters),
                {i: window.size for i, window in windows.items()},
                windows,
            )
        return {i: spans[i].extract(reply, windows[i]) for i, reply in replies.items()}

    def bulk_write(self, rows: Mapping[int, tuple[int, bytes]]) -> None:
        """Write to many servos with one packet, each at its own address; there is no reply."""
        parameters = b""
        for servo_id, (address, data) in rows.items():
            parameters += bytes((servo_id,)) + self._words(address, len(data)) + data
            self._port.pending.invalidate((servo_id,), MemoryRange(address, len(data)))
        self.transceiver.transact(lambda: self._send(BROADCAST_ID, _BULK_WRITE, parameters))

    def factory_reset(self, servo_id: int) -> Reply:
        """Give one servo its factory settings; id and baud rate stay."""
        self._port.pending.invalidate((servo_id,))
        return self._request_packet(servo_id, _FACTORY_RESET, _KEEP_ID_AND_RATE)


# These error bits refuse the request; the other bits are alarms of the servo itself.
_DAMAGED = 0x10
_REFUSALS = {
    0x02: "reports a goal outside its angle limits",
    0x08: "reports a value or address out of range",
    0x40: "does not support the instruction",
}
_ALARMS = 0xFF & ~sum(_REFUSALS, _DAMAGED)


class _Dynamixel1Codec(Protocol1Codec):
    """Codec of protocol 1.0: some error bits are refusals, some are alarms."""

    def interpret(self, frame: StatusPacket, size: int) -> Reply | None:
        alarms = frame.error & _ALARMS
        if frame.error & _DAMAGED and not frame.data:
            found = "received a damaged instruction packet"
            return ReplyFault(frame.servo_id, FaultKind.GARBLED, found, alarms)
        refusals = [text for bit, text in _REFUSALS.items() if frame.error & bit]
        if refusals and not frame.data:
            return ReplyFault(frame.servo_id, FaultKind.REFUSED, " and ".join(refusals), alarms)
        return Status(frame.servo_id, frame.data, alarms) if len(frame.data) == size else None


class Dynamixel1Driver(ProtocolDriver):
    """Driver for AX and MX servos, without sync read; servos in ``bulk_ids`` support bulk read."""

    def __init__(self, port: Port, bulk_ids: Collection[int] = ()) -> None:
        super().__init__(port, Protocol1PacketHandler().txPacket, _Dynamixel1Codec(COMM_TX_ERROR))
        self._bulk_ids = frozenset(bulk_ids)

    def can_bulk_read(self, servo_ids: Iterable[int]) -> bool:
        """Check whether one request can read different bytes of each of these servos."""
        return self._bulk_ids.issuperset(servo_ids)

    def sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, Reply]:
        """Read the same bytes from many servos, with one bulk read for all that support it."""
        return self.bulk_read(dict.fromkeys(servo_ids, MemoryRange(address, size)))

    def bulk_read(self, spans: Mapping[int, MemoryRange]) -> dict[int, Reply]:
        """Read different bytes from each servo; servos without bulk read are read one by one."""
        together = {i: span for i, span in spans.items() if i in self._bulk_ids}
        if len(together) < 2:
            return super().bulk_read(spans)
        with self._port.lock:
            windows = {
                i: self.transceiver.choose_window((i,), span) for i, span in together.items()
            }
            rows = b"".join(bytes((w.size, i, w.address)) for i, w in windows.items())
            replies = self.transceiver.transact(
                lambda: self._send(BROADCAST_ID, BULK_READ, b"\0" + rows),
                {i: window.size for i, window in windows.items()},
                windows,
            )
        found = {i: spans[i].extract(reply, windows[i]) for i, reply in replies.items()}
        return found | super().bulk_read({i: s for i, s in spans.items() if i not in together})

    def factory_reset(self, servo_id: int) -> Reply:
        """Return a fault, because the servo would get id 1, which another servo may have."""
        found = "would get id 1 from a factory reset; restore a backup instead"
        return ReplyFault(servo_id, FaultKind.REFUSED, found)

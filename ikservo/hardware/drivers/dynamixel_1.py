"""Dynamixel protocol 1.0 on dynamixel_sdk: its packets, our own ears.

The SDK builds and sends every packet through ``Protocol1PacketHandler.txPacket``. Its reception
shares the defects of its protocol 2.0 sister: it returns the checksum as data where a servo
refused (D3), and waits by the wall clock, spinning (D7).
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence

from dynamixel_sdk.protocol1_packet_handler import Protocol1PacketHandler
from dynamixel_sdk.robotis_def import COMM_TX_ERROR

from ikservo.hardware.drivers.protocol_1 import Protocol1Dialect, Protocol1Driver
from ikservo.hardware.line.port import Port
from ikservo.hardware.packets.dialect import BROADCAST_ID, Frame
from ikservo.hardware.packets.replies import Fault, FaultKind, Reply, Status
from ikservo.hardware.packets.span import Span

__all__ = ["Dynamixel1Driver"]

_REBOOT, _BULK_READ = 0x08, 0x92

# Bits of the error byte that blame the question; the others are alarms of the servo itself.
_DAMAGED = 0x10
_REFUSALS = {
    0x02: "reports a goal outside its angle limits",
    0x08: "reports a value or address out of range",
    0x40: "does not support the instruction",
}
_ALARMS = 0xFF & ~sum(_REFUSALS, _DAMAGED)


class _Dialect(Protocol1Dialect):
    """How servos of protocol 1.0 answer: some error bits are refusals, some are alarms."""

    def judge(self, frame: Frame, size: int) -> Reply | None:
        alarms = frame.error & _ALARMS
        if frame.error & _DAMAGED and not frame.data:
            found = "received a damaged instruction packet"
            return Fault(frame.servo_id, FaultKind.GARBLED, found, alarms)
        refusals = [words for bit, words in _REFUSALS.items() if frame.error & bit]
        if refusals and not frame.data:
            return Fault(frame.servo_id, FaultKind.REFUSED, " and ".join(refusals), alarms)
        return Status(frame.servo_id, frame.data, alarms) if len(frame.data) == size else None


class Dynamixel1Driver(Protocol1Driver):
    """AX and MX servos; there is no sync read, and only the MX know bulk read.

    Args:
        port: The line.
        bulk_ids: The servos that know bulk read.
    """

    def __init__(self, port: Port, bulk_ids: Collection[int] = ()) -> None:
        super().__init__(port, Protocol1PacketHandler().txPacket, _Dialect(COMM_TX_ERROR))
        self._bulk_ids = frozenset(bulk_ids)

    def can_bulk_read(self, servo_ids: Iterable[int]) -> bool:
        """Whether one question can be put to these servos, each for its own bytes."""
        return self._bulk_ids.issuperset(servo_ids)

    def sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, Reply]:
        """Ask many servos for the same bytes; those that know bulk read with one question."""
        return self.bulk_read(dict.fromkeys(servo_ids, Span(address, size)))

    def bulk_read(self, spans: Mapping[int, Span]) -> dict[int, Reply]:
        """Ask many servos, each for its own bytes; those that cannot, one after the other."""
        together = {i: span for i, span in spans.items() if i in self._bulk_ids}
        if len(together) < 2:
            return super().bulk_read(spans)
        alone = {i: span for i, span in spans.items() if i not in together}
        return self._bulk_read(together) | super().bulk_read(alone)

    def _bulk_read(self, spans: Mapping[int, Span]) -> dict[int, Reply]:
        with self._port.lock:
            windows = {i: self.exchange.window((i,), span) for i, span in spans.items()}
            rows = b"".join(bytes((w.size, i, w.address)) for i, w in windows.items())
            replies = self.exchange.ask(
                lambda: self._send(BROADCAST_ID, _BULK_READ, b"\0" + rows),
                {i: window.size for i, window in windows.items()},
                windows,
            )
        return {i: spans[i].cut(reply, windows[i]) for i, reply in replies.items()}

    def reboot(self, servo_id: int) -> Reply:
        """Restart one servo; its torque is lost. Old AX do not know the instruction."""
        self._port.ghosts.outdate((servo_id,))
        return self._ask(servo_id, _REBOOT, b"")

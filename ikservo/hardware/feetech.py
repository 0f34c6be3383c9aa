"""Feetech servos on scservo_sdk: its packets, our own ears.

The SDK builds and sends every packet. Its reception is not used: it takes late, foreign and
short packets for answers (F1, F7, F13), stops at false headers (F11) and at error bytes above
0x7F (F18), and gives up a whole sync read for one silent servo (F10). Words are packed by the
registers, so the SDK's global byte order (F9) is never consulted.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from scservo_sdk.protocol_packet_handler import protocol_packet_handler
from scservo_sdk.scservo_def import COMM_TX_ERROR

from ikservo.hardware import protocol_1
from ikservo.hardware.exchange import Exchange, Frame, Heard
from ikservo.hardware.port import Port
from ikservo.hardware.replies import Fault, FaultKind, Reply, Status

__all__ = ["FeetechDriver"]

_BROADCAST = 0xFE
_PING, _READ, _WRITE, _REG_WRITE, _ACTION = 0x01, 0x02, 0x03, 0x04, 0x05
_SYNC_READ, _SYNC_WRITE = 0x82, 0x83
_LONGEST_RETURN_DELAY_S = 254 * 2e-6


class _Dialect:
    """How Feetech servos answer: the error byte is an alarm, the data beside it are valid."""

    too_long = COMM_TX_ERROR

    def frame_size(self, size: int) -> int:
        return protocol_1.frame_size(size)

    def scan(self, heard: bytes, size: int, *, final: bool) -> Heard:
        return protocol_1.scan(heard, size, final=final)

    def judge(self, frame: Frame, size: int) -> Reply | None:
        if len(frame.data) == size:
            return Status(frame.servo_id, frame.data, frame.error)
        if frame.data or not frame.error:
            return None  # an answer to some other question
        return Fault(frame.servo_id, FaultKind.REFUSED, "answered without data", frame.error)


class FeetechDriver:
    """STS, SMS and HLS servos; SCS servos with ``can_sync_read=False`` (F16)."""

    def __init__(self, port: Port, *, can_sync_read: bool = True) -> None:
        self._port, self._can_sync_read = port, can_sync_read
        self._handler = protocol_packet_handler()
        self.exchange = Exchange(port, _Dialect(), _LONGEST_RETURN_DELAY_S)

    @property
    def can_sync_read(self) -> bool:
        """Whether one question can be put to many servos."""
        return self._can_sync_read

    def ping(self, servo_id: int) -> Reply:
        """Ask whether a servo is there; a Feetech ping tells nothing more (F14)."""
        return self._ask(servo_id, _PING, b"")

    def read(self, servo_id: int, address: int, size: int) -> Reply:
        """Ask one servo for ``size`` bytes."""
        return self._ask(servo_id, _READ, bytes((address, size)), size)

    def write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Write to one servo and hear whether it took it."""
        return self._ask(servo_id, _WRITE, bytes((address, *data)))

    def sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, Reply]:
        """Ask many servos for the same bytes; each has its own reply."""
        if not self._can_sync_read:
            return {servo_id: self.read(servo_id, address, size) for servo_id in servo_ids}
        parameters = bytes((address, size, *servo_ids))
        return self.exchange.ask(
            lambda: self._send(_BROADCAST, _SYNC_READ, parameters), servo_ids, size
        )

    def sync_write(self, address: int, data: Mapping[int, bytes]) -> None:
        """Write to many servos at once; there is no answer to this."""
        size = len(next(iter(data.values())))
        rows = b"".join(bytes((servo_id, *row)) for servo_id, row in data.items())
        parameters = bytes((address, size)) + rows
        self.exchange.ask(lambda: self._send(_BROADCAST, _SYNC_WRITE, parameters))

    def reg_write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Lay a write ready that ``action`` sets off."""
        return self._ask(servo_id, _REG_WRITE, bytes((address, *data)))

    def action(self) -> None:
        """Set off what ``reg_write`` laid ready, on every servo at the same moment."""
        self.exchange.ask(lambda: self._send(_BROADCAST, _ACTION, b""))

    def reboot(self, servo_id: int) -> Reply:
        """Say that this family has no such instruction."""
        found = "knows no reboot; switch its power off and on instead"
        return Fault(servo_id, FaultKind.REFUSED, found)

    def _ask(self, servo_id: int, instruction: int, parameters: bytes, size: int = 0) -> Reply:
        replies = self.exchange.ask(
            lambda: self._send(servo_id, instruction, parameters), (servo_id,), size
        )
        return replies[servo_id]

    def _send(self, servo_id: int, instruction: int, parameters: bytes) -> int:
        """Hand a packet to the SDK, which puts header and checksum around it and sends it."""
        packet = [0, 0, servo_id, len(parameters) + 2, instruction, *parameters, 0]
        return self._handler.txPacket(self._port, packet)

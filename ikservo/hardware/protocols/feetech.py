"""Driver for Feetech servos, on the vendor's SDK.

The SDK builds and sends every packet. Its reception is not used, because it takes late, foreign and
short packets for replies, stops at false headers and at error bytes above 0x7F, and abandons a
whole sync read if one servo is silent (docs/sdk-defects.md F1, F7, F13, F11, F18, F10). 16-bit
values are packed by the registers, so the SDK's global byte order (F9) is never used.
"""

from __future__ import annotations

from collections.abc import Callable
from inspect import signature

from ikservo.hardware.packets import FaultKind, Reply, ReplyFault, Status, StatusPacket
from ikservo.hardware.port import Port
from ikservo.hardware.protocols.driver import ProtocolDriver
from ikservo.hardware.protocols.protocol1 import Protocol1Codec
from ikservo.hardware.vendor_modules import importing_from

with importing_from("feetech-servo-sdk", "scservo_sdk"):
    from scservo_sdk.protocol_packet_handler import protocol_packet_handler
    from scservo_sdk.scservo_def import COMM_TX_ERROR

_FACTORY_RESET = 0x06


def _packet_sender() -> Callable[[Port, list[int]], int]:
    """Return the SDK's ``txPacket`` as a function of port and packet.

    Two packages provide the module: in feetech-servo-sdk the port is passed to ``txPacket``, in
    ftservo-python-sdk to the handler.
    """
    if "port" in signature(protocol_packet_handler.txPacket).parameters:
        return protocol_packet_handler().txPacket
    return lambda port, packet: protocol_packet_handler(port, 0).txPacket(packet)


class _FeetechCodec(Protocol1Codec):
    """Codec of Feetech servos: the error byte reports alarms; the data stay valid."""

    def interpret(self, frame: StatusPacket, size: int) -> Reply | None:
        if len(frame.data) == size:
            return Status(frame.servo_id, frame.data, frame.error)
        if frame.data or not frame.error:
            return None  # a reply to some other request
        return ReplyFault(frame.servo_id, FaultKind.REFUSED, "answered without data", frame.error)


class FeetechDriver(ProtocolDriver):
    """Driver for STS, SMS and HLS servos; with ``can_sync_read=False`` for SCS servos (F16)."""

    def __init__(self, port: Port, *, can_sync_read: bool = True) -> None:
        super().__init__(port, _packet_sender(), _FeetechCodec(COMM_TX_ERROR))
        self.can_sync_read = can_sync_read

    def factory_reset(self, servo_id: int) -> Reply:
        """Give one servo its factory settings; the id is kept, the baud rate is reset."""
        self._port.pending.invalidate((servo_id,))
        return self._request_packet(servo_id, _FACTORY_RESET, b"")

    def reboot(self, servo_id: int) -> Reply:
        """Return a fault, because this family has no such instruction."""
        found = "does not support reboot; switch its power off and on instead"
        return ReplyFault(servo_id, FaultKind.REFUSED, found)

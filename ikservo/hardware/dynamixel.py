"""Dynamixel protocol 2.0 on dynamixel_sdk: its packets, our own ears.

The SDK builds and sends every packet through ``txPacket``, which is the same in 3.7.31 and in
4.1.0 (D11). Corrected on the way out: byte stuffing, which it computes and then forgets (D1).
Its reception is not used: it loses a byte of some stuffed answers (D2), returns the CRC as data
where a servo refused (D3), and drops what servos say about themselves in sync reads (D4, D5).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from dynamixel_sdk.protocol2_packet_handler import Protocol2PacketHandler
from dynamixel_sdk.robotis_def import COMM_TX_ERROR

from ikservo.hardware.exchange import Exchange
from ikservo.hardware.fast_sync import combined_size, split
from ikservo.hardware.port import Port
from ikservo.hardware.protocol_2 import Answers, CombinedAnswer
from ikservo.hardware.replies import Fault, Reply
from ikservo.hardware.stuffing import stuffed, unstuffed

__all__ = ["DynamixelDriver"]

_BROADCAST = 0xFE
_PING, _READ, _WRITE, _REG_WRITE, _ACTION, _REBOOT = 0x01, 0x02, 0x03, 0x04, 0x05, 0x08
_SYNC_READ, _SYNC_WRITE, _FAST_SYNC_READ = 0x82, 0x83, 0x8A
_FAST_FAILURES = 2  # in a row; then the firmware is too old, or a servo is absent
_LONGEST_RETURN_DELAY_S = 254 * 2e-6

_LEN, _INSIDE = 5, 7  # where the length field and the instruction stand


class _Handler(Protocol2PacketHandler):
    """The SDK's packet handler with its stuffing put right (D1, D2)."""

    def addStuffing(self, packet: list[int]) -> list[int]:  # noqa: N802 (the SDK calls it)
        """Stuff in place: ``txPacket`` does not look at what this returns."""
        inside = stuffed(bytes(packet[_INSIDE:-2]))
        packet[_LEN:] = [*(len(inside) + 2).to_bytes(2, "little"), *inside, 0, 0]
        return packet

    def removeStuffing(self, packet: list[int]) -> list[int]:  # noqa: N802 (the SDK calls it)
        """Unstuff in place."""
        inside = unstuffed(bytes(packet[_INSIDE:-2]))
        packet[_LEN:-2] = [*(len(inside) + 2).to_bytes(2, "little"), *inside]
        return packet


class DynamixelDriver:
    """X-series servos and everything else that speaks protocol 2.0.

    Many servos are asked by fast sync read, which saves a third of the wire time, until it fails
    twice in a row (D5: a missing servo takes all answers with it); then, and whenever it fails,
    they are asked by sync read.
    """

    can_sync_read = True

    def __init__(self, port: Port, *, fast: bool = True) -> None:
        self._port, self._handler = port, _Handler()
        self._dialect = Answers(self._handler.updateCRC, COMM_TX_ERROR)
        self.exchange = Exchange(port, self._dialect, _LONGEST_RETURN_DELAY_S)
        self._combined = Exchange(
            port, CombinedAnswer(self._handler.updateCRC, COMM_TX_ERROR), _LONGEST_RETURN_DELAY_S
        )
        self._fast_tries = _FAST_FAILURES if fast else 0

    def ping(self, servo_id: int) -> Reply:
        """Ask whether a servo is there; the data are model number (2 bytes) and firmware."""
        return self._ask(servo_id, _PING, b"", 3)

    def read(self, servo_id: int, address: int, size: int) -> Reply:
        """Ask one servo for ``size`` bytes."""
        return self._ask(servo_id, _READ, _words(address, size), size)

    def write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Write to one servo and hear whether it took it."""
        return self._ask(servo_id, _WRITE, _words(address) + data)

    def sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, Reply]:
        """Ask many servos for the same bytes; each has its own reply."""
        parameters = _words(address, size) + bytes(servo_ids)
        if self._fast_tries and len(servo_ids) > 1:
            replies = self._fast_sync_read(parameters, servo_ids, size)
            self._fast_tries = _FAST_FAILURES if replies else self._fast_tries - 1
            if replies:
                return replies
        return self.exchange.ask(
            lambda: self._send(_BROADCAST, _SYNC_READ, parameters), servo_ids, size
        )

    def _fast_sync_read(
        self, parameters: bytes, servo_ids: Sequence[int], size: int
    ) -> dict[int, Reply]:
        """Return every servo's reply, or nothing if they could not be had this way."""
        self._combined.return_delay_s = len(servo_ids) * self.exchange.return_delay_s
        reply = self._combined.ask(
            lambda: self._send(_BROADCAST, _FAST_SYNC_READ, parameters),
            (_BROADCAST,),
            combined_size(len(servo_ids), size),
        )[_BROADCAST]
        frames = [] if isinstance(reply, Fault) else split(reply.data, servo_ids, size)
        judged = {frame.servo_id: self._dialect.judge(frame, size) for frame in frames}
        return {servo_id: reply for servo_id, reply in judged.items() if reply}

    def sync_write(self, address: int, data: Mapping[int, bytes]) -> None:
        """Write to many servos at once; there is no answer to this."""
        size = len(next(iter(data.values())))
        rows = b"".join(bytes((servo_id, *row)) for servo_id, row in data.items())
        parameters = _words(address, size) + rows
        self.exchange.ask(lambda: self._send(_BROADCAST, _SYNC_WRITE, parameters))

    def reg_write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Lay a write ready that ``action`` sets off."""
        return self._ask(servo_id, _REG_WRITE, _words(address) + data)

    def action(self) -> None:
        """Set off what ``reg_write`` laid ready; always to all, for one would answer (D10)."""
        self.exchange.ask(lambda: self._send(_BROADCAST, _ACTION, b""))

    def reboot(self, servo_id: int) -> Reply:
        """Restart one servo; its torque is lost."""
        return self._ask(servo_id, _REBOOT, b"")

    def _ask(self, servo_id: int, instruction: int, parameters: bytes, size: int = 0) -> Reply:
        replies = self.exchange.ask(
            lambda: self._send(servo_id, instruction, parameters), (servo_id,), size
        )
        return replies[servo_id]

    def _send(self, servo_id: int, instruction: int, parameters: bytes) -> int:
        """Hand a packet to the SDK, which puts header and CRC around it and sends it."""
        length = (len(parameters) + 3).to_bytes(2, "little")
        packet = [0, 0, 0, 0, servo_id, *length, instruction, *parameters, 0, 0]
        return self._handler.txPacket(self._port, packet)


def _words(*words: int) -> bytes:
    return b"".join(word.to_bytes(2, "little") for word in words)

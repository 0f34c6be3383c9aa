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

from ikservo.hardware.exchange import Exchange, Frame, Heard
from ikservo.hardware.fast_sync import combined_size, split
from ikservo.hardware.port import Port
from ikservo.hardware.replies import Fault, FaultKind, Reply, Status
from ikservo.hardware.stuffing import stuffed, unstuffed

__all__ = ["DynamixelDriver"]

_BROADCAST = 0xFE
_PING, _READ, _WRITE, _REG_WRITE, _ACTION, _REBOOT = 0x01, 0x02, 0x03, 0x04, 0x05, 0x08
_STATUS, _SYNC_READ, _SYNC_WRITE, _FAST_SYNC_READ = 0x55, 0x82, 0x83, 0x8A
_FAST_FAILURES = 2  # in a row; then the firmware is too old, or a servo is absent
_LONGEST_RETURN_DELAY_S = 254 * 2e-6

_HEADER = b"\xff\xff\xfd\x00"
_LEN, _INSIDE, _DATA = 5, 7, 9  # where the length field, the instruction and the data stand
_LONGEST = 1024

_ALERT = 0x80
_CRC_ERROR = 3
_REFUSALS = {
    1: "could not carry it out",
    2: "does not know the instruction",
    _CRC_ERROR: "heard a damaged question",
    4: "finds the value out of range",
    5: "finds the data too short or too long",
    6: "finds the value beyond a limit it holds",
    7: "denies access (read-only, no such address, or EEPROM while torque is on)",
}


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


class _Dialect:
    """How Dynamixels answer: ``FF FF FD 00 ID LEN 55 ERR data CRC``, inside stuffed."""

    too_long = COMM_TX_ERROR
    highest_id = 0xFC

    def __init__(self, handler: Protocol2PacketHandler) -> None:
        self._handler = handler

    def frame_size(self, size: int) -> int:
        return size + 11

    def scan(self, heard: bytes, size: int, *, final: bool) -> Heard:
        """Find the status packets; a false header does not hide a packet behind it."""
        frames: list[Frame] = []
        at = junk = 0
        while at < len(heard):
            end = at + self._packet_length(heard, at)
            if end > len(heard) and not final and self._may_continue(heard, at, size):
                return Heard(tuple(frames), len(heard) - at, junk)
            if at < end <= len(heard) and self._crc_is_right(heard[at:end]):
                frames += self._frames(heard[at:end])
                at = end
            else:
                at, junk = at + 1, junk + 1
        return Heard(tuple(frames), 0, junk)

    def judge(self, frame: Frame, size: int) -> Reply | None:
        number, alert = frame.error & ~_ALERT, frame.error & _ALERT
        if number:
            kind = FaultKind.GARBLED if number == _CRC_ERROR else FaultKind.REFUSED
            found = _REFUSALS.get(number, f"answered with unknown error {number}")
            return Fault(frame.servo_id, kind, found, alert)
        if len(frame.data) != size:
            return None  # an answer to some other question
        return Status(frame.servo_id, frame.data, alert)

    def _packet_length(self, heard: bytes, at: int) -> int:
        """Return the length of the packet that begins here: 0 if none does, a lot if unknown."""
        start = heard[at : at + _INSIDE]
        if start[:4] != _HEADER[: len(start)]:
            return 0
        if len(start) < _INSIDE:
            return _LONGEST
        length = int.from_bytes(start[_LEN:], "little")
        return length + _INSIDE if 3 <= length <= _LONGEST else 0

    def _crc_is_right(self, packet: bytes) -> bool:
        crc = self._handler.updateCRC(0, packet, len(packet) - 2)
        return crc == int.from_bytes(packet[-2:], "little")

    def _may_continue(self, heard: bytes, at: int, size: int) -> bool:
        """Return whether the bytes from here on may become the hoped-for packet."""
        start = heard[at : at + _INSIDE + 1]
        if len(start) > 4 and start[4] > self.highest_id:
            return False
        if len(start) >= _INSIDE:
            stuffing = (size + 1) // 3 + 1
            data = int.from_bytes(start[_LEN:_INSIDE], "little") - 4
            if data != 0 and not size <= data <= size + stuffing:
                return False
        return len(start) <= _INSIDE or start[_INSIDE] == _STATUS

    def _frames(self, packet: bytes) -> list[Frame]:
        """Return the status frame of a packet; an instruction, such as our own echo, is none."""
        if packet[_INSIDE] != _STATUS or packet[4] > self.highest_id or len(packet) < 11:
            return []
        inside = self._unstuffed(packet[_INSIDE:-2])
        return [Frame(packet[4], inside[1], inside[2:])]

    def _unstuffed(self, inside: bytes) -> bytes:
        return unstuffed(inside)


class _Combined(_Dialect):
    """The one packet of a fast sync read: never stuffed, its error byte is the first servo's."""

    highest_id = _BROADCAST

    def judge(self, frame: Frame, size: int) -> Reply | None:
        complete = len(frame.data) == size
        return Status(frame.servo_id, bytes((frame.error, *frame.data))) if complete else None

    def _unstuffed(self, inside: bytes) -> bytes:
        return inside


class DynamixelDriver:
    """X-series servos and everything else that speaks protocol 2.0.

    Many servos are asked by fast sync read, which saves a third of the wire time, until it fails
    twice in a row (D5: a missing servo takes all answers with it); then, and whenever it fails,
    they are asked by sync read.
    """

    can_sync_read = True

    def __init__(self, port: Port, *, fast: bool = True) -> None:
        self._port, self._handler = port, _Handler()
        self._dialect = _Dialect(self._handler)
        self.exchange = Exchange(port, self._dialect, _LONGEST_RETURN_DELAY_S)
        self._combined = Exchange(port, _Combined(self._handler), _LONGEST_RETURN_DELAY_S)
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

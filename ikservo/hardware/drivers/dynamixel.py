"""Dynamixel protocol 2.0 on dynamixel_sdk: its packets, our own ears.

The SDK builds and sends every packet through ``txPacket``, which is the same in 3.7.31 and in
4.1.0 (D11). Corrected on the way out: byte stuffing, which it computes and then forgets (D1).
Its reception is not used: it loses a byte of some stuffed answers (D2), returns the CRC as data
where a servo refused (D3), and drops what servos say about themselves in sync reads (D4, D5).
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence

from dynamixel_sdk.robotis_def import COMM_TX_ERROR

from ikservo.hardware.drivers.dynamixel_packets import PacketHandler
from ikservo.hardware.drivers.fast_sync import combined_size, split
from ikservo.hardware.finding.roll_call import RollCall, hear_all
from ikservo.hardware.line.port import Port
from ikservo.hardware.packets.dialect import BROADCAST_ID
from ikservo.hardware.packets.exchange import Exchange
from ikservo.hardware.packets.phrasebook import Phrasebook
from ikservo.hardware.packets.protocol_2 import Answers, CombinedAnswer
from ikservo.hardware.packets.replies import Fault, Reply
from ikservo.hardware.packets.span import Span

__all__ = ["DynamixelDriver"]

_PING, _READ, _WRITE, _REG_WRITE, _ACTION, _REBOOT = 0x01, 0x02, 0x03, 0x04, 0x05, 0x08
_SYNC_READ, _SYNC_WRITE, _FAST_SYNC_READ = 0x82, 0x83, 0x8A
_BULK_READ, _BULK_WRITE = 0x92, 0x93
_QUESTIONS = frozenset((_READ, _SYNC_READ, _FAST_SYNC_READ, _BULK_READ))
_PING_SIZE = 3  # model number and firmware
_FAST_FAILURES = 2  # in a row; then the firmware is too old, a servo is absent, or the line bad
_TRY_AGAIN = 200  # readings, after which the fast way gets another chance


class DynamixelDriver:
    """X-series servos and everything else that speaks protocol 2.0.

    Many servos are asked by fast sync read, which saves a third of the wire time, until it fails
    twice in a row for the same servos (D5: a missing one takes all answers with it); then, and
    whenever it fails, they are asked by sync read.
    """

    can_sync_read = can_bulk_write = True

    def __init__(self, port: Port, *, fast: bool = True) -> None:
        self._port, self._handler = port, PacketHandler()
        self._send = Phrasebook(port, self._write, _QUESTIONS).send
        self._dialect = Answers(COMM_TX_ERROR)
        self.exchange = Exchange(port, self._dialect)
        self._combined = Exchange(port, CombinedAnswer(COMM_TX_ERROR))
        self._fast, self._fast_failures = fast, dict[tuple[int, ...], int]()
        self.repeated_itself = False

    def set_return_delay(self, return_delay_s: float) -> None:
        """Wait no longer than this before each answer, seconds."""
        for exchange in (self.exchange, self._combined):
            exchange.set_return_delay(return_delay_s)

    def can_bulk_read(self, servo_ids: Iterable[int]) -> bool:
        """Whether one question can be put to these servos, each for its own bytes."""
        return True

    def ping(self, servo_id: int) -> Reply:
        """Ask whether a servo is there; the data are model number (2 bytes) and firmware."""
        return self._ask(servo_id, _PING, b"", _PING_SIZE)

    def roll_call(self, highest_id: int) -> RollCall:
        """Ask everybody up to an id whether they are there."""
        return hear_all(
            self.exchange, lambda: self._send(BROADCAST_ID, _PING, b""), _PING_SIZE, highest_id
        )

    def read(self, servo_id: int, address: int, size: int) -> Reply:
        """Ask one servo for ``size`` bytes."""
        span = Span(address, size)
        with self._port.lock:
            window = self.exchange.window((servo_id,), span)
            parameters = _words(window.address, window.size)
            reply = self._ask(servo_id, _READ, parameters, window.size, window)
        return span.cut(reply, window)

    def write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Write to one servo and hear whether it took it."""
        self._port.ghosts.outdate((servo_id,))
        return self._ask(servo_id, _WRITE, _words(address) + data)

    def sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, Reply]:
        """Ask many servos for the same bytes; each has its own reply."""
        span, ids = Span(address, size), tuple(servo_ids)
        with self._port.lock:
            self.repeated_itself = self._is_fast(ids)
            replies = self._fast_sync_read(ids, span) if self._is_fast(ids) else {}
            if replies:
                self._fast_failures.pop(ids, None)
                self.repeated_itself = False
                return replies
            self._fast_failures[ids] = self._fast_failures.get(ids, 0) + 1
            return self._slow_sync_read(ids, span)

    def _is_fast(self, servo_ids: tuple[int, ...]) -> bool:
        failures = self._fast_failures.get(servo_ids, 0)
        worth_it = failures < _FAST_FAILURES or failures % _TRY_AGAIN == 0
        return self._fast and len(servo_ids) > 1 and worth_it

    def _slow_sync_read(self, servo_ids: tuple[int, ...], span: Span) -> dict[int, Reply]:
        window = self.exchange.window(servo_ids, span)
        parameters = _words(window.address, window.size) + bytes(servo_ids)
        replies = self.exchange.ask(
            lambda: self._send(BROADCAST_ID, _SYNC_READ, parameters),
            dict.fromkeys(servo_ids, window.size),
            window,
        )
        return {servo_id: span.cut(reply, window) for servo_id, reply in replies.items()}

    def _fast_sync_read(self, servo_ids: tuple[int, ...], span: Span) -> dict[int, Reply]:
        """Return every servo's reply, or nothing if they could not be had this way."""
        count = len(servo_ids)
        window = self._combined.window(
            (BROADCAST_ID,), span, lambda size: combined_size(count, size)
        )
        parameters = _words(window.address, window.size) + bytes(servo_ids)
        reply = self._combined.ask(
            lambda: self._send(BROADCAST_ID, _FAST_SYNC_READ, parameters),
            {BROADCAST_ID: combined_size(count, window.size)},
            window,
        )[BROADCAST_ID]
        frames = [] if isinstance(reply, Fault) else split(reply.data, servo_ids, window.size)
        judged = {frame.servo_id: self._dialect.judge(frame, window.size) for frame in frames}
        return {i: span.cut(reply, window) for i, reply in judged.items() if reply}

    def bulk_read(self, spans: Mapping[int, Span]) -> dict[int, Reply]:
        """Ask many servos, each for its own bytes."""
        with self._port.lock:
            windows = {i: self.exchange.window((i,), span) for i, span in spans.items()}
            rows = (bytes((i,)) + _words(w.address, w.size) for i, w in windows.items())
            parameters = b"".join(rows)
            replies = self.exchange.ask(
                lambda: self._send(BROADCAST_ID, _BULK_READ, parameters),
                {i: window.size for i, window in windows.items()},
                windows,
            )
        return {i: spans[i].cut(reply, windows[i]) for i, reply in replies.items()}

    def sync_write(self, address: int, data: Mapping[int, bytes]) -> None:
        """Write to many servos at once; there is no answer to this."""
        size = len(next(iter(data.values())))
        rows = b"".join(bytes((servo_id, *row)) for servo_id, row in data.items())
        parameters = _words(address, size) + rows
        self._port.ghosts.outdate(data, Span(address, size))
        self.exchange.ask(lambda: self._send(BROADCAST_ID, _SYNC_WRITE, parameters))

    def bulk_write(self, rows: Mapping[int, tuple[int, bytes]]) -> None:
        """Write to many servos at once, each to its own address; there is no answer to this."""
        parameters = b""
        for servo_id, (address, data) in rows.items():
            parameters += bytes((servo_id,)) + _words(address, len(data)) + data
            self._port.ghosts.outdate((servo_id,), Span(address, len(data)))
        self.exchange.ask(lambda: self._send(BROADCAST_ID, _BULK_WRITE, parameters))

    def reg_write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Lay a write ready that ``action`` sets off."""
        return self._ask(servo_id, _REG_WRITE, _words(address) + data)

    def action(self) -> None:
        """Set off what ``reg_write`` laid ready; always to all, for one would answer (D10)."""
        self._port.ghosts.outdate(range(BROADCAST_ID))
        self.exchange.ask(lambda: self._send(BROADCAST_ID, _ACTION, b""))

    def reboot(self, servo_id: int) -> Reply:
        """Restart one servo; its torque is lost."""
        self._port.ghosts.outdate((servo_id,))
        return self._ask(servo_id, _REBOOT, b"")

    def _ask(
        self,
        servo_id: int,
        instruction: int,
        parameters: bytes,
        size: int = 0,
        window: Span | None = None,
    ) -> Reply:
        replies = self.exchange.ask(
            lambda: self._send(servo_id, instruction, parameters), {servo_id: size}, window
        )
        return replies[servo_id]

    def _write(self, servo_id: int, instruction: int, parameters: bytes) -> int:
        """Hand a packet to the SDK, which puts header and CRC around it and sends it."""
        length = (len(parameters) + 3).to_bytes(2, "little")
        packet = [0, 0, 0, 0, servo_id, *length, instruction, *parameters, 0, 0]
        return self._handler.txPacket(self._port, packet)


def _words(*words: int) -> bytes:
    return b"".join(word.to_bytes(2, "little") for word in words)

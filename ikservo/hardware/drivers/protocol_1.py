"""What Feetech and Dynamixel protocol 1.0 drivers share: the same packets, other dialects."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence

from ikservo.hardware.finding.roll_call import RollCall, hear_all
from ikservo.hardware.line.port import Port
from ikservo.hardware.packets import protocol_1
from ikservo.hardware.packets.dialect import BROADCAST_ID, Dialect, Frame, Heard
from ikservo.hardware.packets.exchange import Exchange
from ikservo.hardware.packets.phrasebook import Phrasebook
from ikservo.hardware.packets.replies import Reply
from ikservo.hardware.packets.span import Span

__all__ = ["Protocol1Dialect", "Protocol1Driver"]

_PING, _READ, _WRITE, _REG_WRITE, _ACTION = 0x01, 0x02, 0x03, 0x04, 0x05
_SYNC_WRITE = 0x83
_QUESTIONS = frozenset((_READ, 0x82, 0x92))  # of one servo, and of many: sync read, bulk read
_PING_SIZE = 0

Send = Callable[[Port, list[int]], int]


class Protocol1Dialect:
    """How status packets look; what they mean, each family says for itself."""

    def __init__(self, too_long: int) -> None:
        self.too_long = too_long

    def frame_size(self, size: int) -> int:
        """Return the bytes of a status packet with ``size`` bytes of data."""
        return protocol_1.frame_size(size)

    def scan(self, heard: bytes, sizes: Iterable[int], *, final: bool) -> Heard:
        """Find the status packets."""
        return protocol_1.scan(heard, tuple(sizes), final=final)

    def in_order(self, heard: bytes, sizes: Mapping[int, int]) -> dict[int, Reply] | None:
        """Return the answers, if the bytes are those of healthy servos in order, nothing else."""
        return protocol_1.in_order(heard, sizes)

    def judge(self, frame: Frame, size: int) -> Reply | None:
        """Return what a frame says to a question for ``size`` bytes."""
        raise NotImplementedError


class Protocol1Driver:
    """Instructions that both families know.

    Args:
        port: The line.
        send: The vendor's ``txPacket``, which puts header and checksum around a packet.
        dialect: How this family's servos answer.
    """

    can_sync_read = can_bulk_write = repeated_itself = False

    def __init__(self, port: Port, send: Send, dialect: Dialect) -> None:
        self._port, self._tx_packet = port, send
        self._send = Phrasebook(port, self._write, _QUESTIONS).send
        self.exchange = Exchange(port, dialect)

    def set_return_delay(self, return_delay_s: float) -> None:
        """Wait no longer than this before each answer, seconds."""
        self.exchange.set_return_delay(return_delay_s)

    def can_bulk_read(self, servo_ids: Iterable[int]) -> bool:
        """Whether one question can be put to these servos, each for its own bytes."""
        return False

    def ping(self, servo_id: int) -> Reply:
        """Ask whether a servo is there; a ping of this protocol tells nothing more (F14)."""
        return self._ask(servo_id, _PING, b"")

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
            parameters = bytes((window.address, window.size))
            return span.cut(self._ask(servo_id, _READ, parameters, window), window)

    def write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Write to one servo and hear whether it took it."""
        self._port.ghosts.outdate((servo_id,))
        return self._ask(servo_id, _WRITE, bytes((address, *data)))

    def sync_read(self, servo_ids: Sequence[int], address: int, size: int) -> dict[int, Reply]:
        """Ask many servos for the same bytes, here one after the other."""
        return {servo_id: self.read(servo_id, address, size) for servo_id in servo_ids}

    def bulk_read(self, spans: Mapping[int, Span]) -> dict[int, Reply]:
        """Ask many servos, each for its own bytes, here one after the other."""
        return {i: self.read(i, span.address, span.size) for i, span in spans.items()}

    def sync_write(self, address: int, data: Mapping[int, bytes]) -> None:
        """Write to many servos at once; there is no answer to this."""
        size = len(next(iter(data.values())))
        rows = b"".join(bytes((servo_id, *row)) for servo_id, row in data.items())
        self._port.ghosts.outdate(data, Span(address, size))
        parameters = bytes((address, size)) + rows
        self.exchange.ask(lambda: self._send(BROADCAST_ID, _SYNC_WRITE, parameters))

    def bulk_write(self, rows: Mapping[int, tuple[int, bytes]]) -> None:
        """Write to many servos, each to its own address, here one write after the other."""
        for servo_id, (address, data) in rows.items():
            self.sync_write(address, {servo_id: data})

    def reg_write(self, servo_id: int, address: int, data: bytes) -> Reply:
        """Lay a write ready that ``action`` sets off."""
        return self._ask(servo_id, _REG_WRITE, bytes((address, *data)))

    def action(self) -> None:
        """Set off what ``reg_write`` laid ready, on every servo at the same moment."""
        self._port.ghosts.outdate(range(BROADCAST_ID))
        self.exchange.ask(lambda: self._send(BROADCAST_ID, _ACTION, b""))

    def _ask(
        self, servo_id: int, instruction: int, parameters: bytes, window: Span | None = None
    ) -> Reply:
        replies = self.exchange.ask(
            lambda: self._send(servo_id, instruction, parameters),
            {servo_id: window.size if window else 0},
            window,
        )
        return replies[servo_id]

    def _write(self, servo_id: int, instruction: int, parameters: bytes) -> int:
        packet = [0, 0, servo_id, len(parameters) + 2, instruction, *parameters, 0]
        return self._tx_packet(self._port, packet)

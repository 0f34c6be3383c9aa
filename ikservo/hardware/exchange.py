"""One question on the line and the answers to it, found again amid echo, noise and stale bytes."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

from ikservo.errors import BusError, PortLostError
from ikservo.hardware.port import Port
from ikservo.hardware.replies import Fault, FaultKind, Reply

__all__ = ["Dialect", "Exchange", "Frame", "Heard"]


@dataclass(frozen=True, slots=True)
class Frame:
    """A status packet whose checksum is right.

    Attributes:
        servo_id: Who says it.
        error: The error byte.
        data: The parameters.
    """

    servo_id: int
    error: int
    data: bytes


@dataclass(frozen=True, slots=True)
class Heard:
    """What a dialect makes of the bytes so far.

    Attributes:
        frames: Status packets whose checksums are right, in order.
        pending: Bytes at the end that may be the beginning of another.
        junk: Bytes that belong to no packet.
    """

    frames: tuple[Frame, ...]
    pending: int
    junk: int


class Dialect(Protocol):
    """How one protocol writes a status packet."""

    @property
    def too_long(self) -> int:
        """Return the code by which the vendor's SDK says that a packet is too long to send."""
        ...

    def frame_size(self, size: int) -> int:
        """Return the bytes of a status packet with ``size`` bytes of data."""
        ...

    def scan(self, heard: bytes, size: int, *, final: bool) -> Heard:
        """Find the status packets; ``final`` means that no more bytes will come."""
        ...

    def judge(self, frame: Frame, size: int) -> Reply | None:
        """Return what a frame says to a question for ``size`` bytes; None if it is no answer."""
        ...


class Exchange:
    """Puts questions on a port and hears the answers out.

    Attributes:
        port: The line.
        dialect: How answers are written.
        return_delay_s: The longest a servo waits before it answers, seconds.
    """

    def __init__(self, port: Port, dialect: Dialect, return_delay_s: float) -> None:
        self.port, self.dialect, self.return_delay_s = port, dialect, return_delay_s
        self._echoes: bool | None = None  # whether the adapter hears itself; unknown at first

    def ask(
        self, send: Callable[[], int], servo_ids: Sequence[int] = (), size: int = 0
    ) -> dict[int, Reply]:
        """Send a packet, then hear each servo out.

        Args:
            send: Puts the packet on the line through the vendor's SDK; returns its result code.
            servo_ids: Who will answer.
            size: Bytes of data that each answer carries.

        Returns:
            A status or a fault for every id.

        Raises:
            PortLostError: The line is gone.
        """
        with self.port.exchange():
            self._send(send)
            return self._hear_out(servo_ids, size) if servo_ids else {}

    def _send(self, send: Callable[[], int]) -> None:
        result = send()
        if result == self.dialect.too_long:
            raise BusError(
                "cannot carry so long a packet", "Ask fewer servos at once.", port=self.port.name
            )
        if result != 0:
            raise PortLostError(self.port.name, "it did not take the whole packet")

    def _hear_out(self, servo_ids: Sequence[int], size: int) -> dict[int, Reply]:
        expected = len(servo_ids) * self.dialect.frame_size(size)
        deadline_s = self.port.deadline_s(expected, len(servo_ids) * self.return_delay_s)
        started_s = self.port.clock.now_s()
        raw = bytearray()
        while True:
            heard = self._scan(raw, size, final=False)
            answers = self._answers(heard.frames, servo_ids, size)
            if len(answers) == len(servo_ids):
                break
            missing = expected - len(answers) * self.dialect.frame_size(size) - heard.pending
            chunk = self.port.read_until(max(missing, 1), deadline_s)
            if not chunk:
                return self._overdue(bytes(raw), servo_ids, size)
            raw += chunk
        self._learn(raw, started_s)
        return answers

    def _learn(self, raw: bytearray, started_s: float) -> None:
        self._echoes = raw.startswith(self.port.sent)
        took_s = self.port.clock.now_s() - started_s
        self.port.patience.learn(took_s - self.port.wire_s(len(self.port.sent) + len(raw)))

    def _scan(self, raw: bytearray | bytes, size: int, *, final: bool) -> Heard:
        """Scan behind the echo of our own packet, which reads like an answer (F12)."""
        sent = self.port.sent
        if self._echoes is not False and raw:
            if raw.startswith(sent):
                raw = raw[len(sent) :]
            elif not final and sent.startswith(raw):
                return Heard((), 0, 0)
        return self.dialect.scan(bytes(raw), size, final=final)

    def _answers(
        self, frames: Iterable[Frame], servo_ids: Sequence[int], size: int
    ) -> dict[int, Reply]:
        answers: dict[int, Reply] = {}
        for frame in frames:
            reply = self.dialect.judge(frame, size)
            if reply is None or frame.servo_id not in servo_ids:
                continue
            first = answers.setdefault(frame.servo_id, reply)
            if first != reply:
                answers[frame.servo_id] = self._contradiction(frame.servo_id)
        return answers

    def _contradiction(self, servo_id: int) -> Fault:
        return Fault(servo_id, FaultKind.GARBLED, "gave two answers that differ")

    def _overdue(self, raw: bytes, servo_ids: Sequence[int], size: int) -> dict[int, Reply]:
        """Make the best of what was heard once the deadline has passed."""
        self.port.unsettle()
        heard = self._scan(raw, size, final=True)
        answers = self._answers(heard.frames, servo_ids, size)
        if not answers and raw == self.port.sent and self._echoes is None and size == 0:
            # A ping's echo and its answer with a voltage alarm are the same bytes (Feetech).
            answers = self._answers(
                self.dialect.scan(raw, size, final=True).frames, servo_ids, size
            )
        absent = (servo_id for servo_id in servo_ids if servo_id not in answers)
        return answers | {i: self._missing(i, heard, raw) for i in absent}

    def _missing(self, servo_id: int, heard: Heard, raw: bytes) -> Fault:
        kind = FaultKind.GARBLED if heard.junk else FaultKind.SILENT
        found = "sent a damaged answer" if heard.junk else "does not answer"
        return Fault(servo_id, kind, found, sent=self.port.sent, received=raw)

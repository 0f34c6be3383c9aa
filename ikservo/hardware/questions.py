"""Putting questions until they are answered: repeats, doubts, counts, alarms, errors with names."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from ikservo.errors import BadReplyError, BusError, ServoRefusedError, ServoSilentError
from ikservo.hardware.absence import Absence
from ikservo.hardware.drivers.choice import driver_for
from ikservo.hardware.drivers.driver import Driver
from ikservo.hardware.finding.chain_order import silence_hint
from ikservo.hardware.gathering import gather
from ikservo.hardware.line.port import Port
from ikservo.hardware.packets.replies import Fault, FaultKind, Reply, Status
from ikservo.hardware.packets.span import Span
from ikservo.hardware.servo import ServoSpec
from ikservo.hardware.statistics import ServoStatistics
from ikservo.registers import Alarm, Family

__all__ = ["Questions"]

_ERRORS: Mapping[FaultKind, type[BusError]] = {
    FaultKind.SILENT: ServoSilentError,
    FaultKind.GARBLED: BadReplyError,
    FaultKind.REFUSED: ServoRefusedError,
}
_NO_ALARMS: frozenset[Alarm] = frozenset()


class Questions:
    """Asks the servos of one line, in whatever dialects they speak.

    Attributes:
        port: The line.
        retries: How often a question is put again that may be repeated.
        statistics: How well each servo answers.
        alarms: What each complained about in its latest answer.
    """

    def __init__(
        self, port: Port, servos: Sequence[ServoSpec], retries: int, *, fast: bool
    ) -> None:
        self.port, self.retries, self._chain = port, retries, tuple(servos)
        self.statistics = {servo.id: ServoStatistics() for servo in servos}
        self.alarms: dict[int, frozenset[Alarm]] = {}
        self._absence = Absence()
        bulk_ids = [servo.id for servo in servos if servo.table.bulk_read]
        self.drivers: dict[Family, Driver] = {
            family: driver_for(family, port, fast=fast, bulk_ids=bulk_ids)
            for family in dict.fromkeys(servo.table.family for servo in servos)
        }

    def driver(self, servo: ServoSpec) -> Driver:
        """Return the driver that speaks the servo's dialect."""
        return self.drivers[servo.table.family]

    def one(
        self,
        servo: ServoSpec,
        asked: str,
        question: Callable[[], Reply],
        *,
        repeat: bool = True,
        confirm: Callable[[Status], bool] | None = None,
    ) -> bytes:
        """Put a question to one servo until it is answered.

        Args:
            servo: Whom.
            asked: What, in words, for errors.
            question: Puts it once.
            repeat: It may be put again if the answer is lost. If not, it is put only when no
                older answer can pass for its own.
            confirm: Says whether an answer is true, where that is in doubt.

        Raises:
            BusError: No usable answer, or a refusal.
        """
        if not repeat:
            self.driver(servo).exchange.wait_out((servo.id,))
            return self._answered(servo, self._once(servo, question), asked)
        reply = self._believed(servo, question, confirm)
        for _ in range(self.retries):
            if not _is_lost(reply):
                break
            self.statistics[servo.id].retried += 1
            reply = self._believed(servo, question, confirm)
        return self._answered(servo, reply, asked)

    def many(
        self,
        servos: Sequence[ServoSpec],
        spans: Mapping[int, Span],
        asked: str,
        *,
        steady: bool = False,
    ) -> tuple[dict[int, bytes], dict[int, BusError]]:
        """Read a span of each of many servos' memories, with as few questions as can be.

        Those whose answers are lost are asked once more together; those that have been deaf for
        long are asked only every so often.

        Args:
            servos: Whom.
            spans: What, by id.
            asked: The same in words, for errors.
            steady: What is read does not change by itself, so that it can be read twice.

        Returns:
            The bytes of those who answered and the errors of those who did not.
        """
        replies = self._all_believed(servos, spans, steady=steady)
        again = [servo for servo in servos if self._worth_repeating(servo, replies[servo.id])]
        if again and self.retries:
            for servo in again:
                self.statistics[servo.id].retried += 1
            replies |= self._all_believed(again, spans, steady=steady)
        data: dict[int, bytes] = {}
        errors: dict[int, BusError] = {}
        for servo in servos:
            reply = replies[servo.id]
            if isinstance(reply, Fault):
                errors[servo.id] = self.error(servo, reply, asked)
            else:
                data[servo.id] = reply.data
        return data, errors

    def error(self, servo: ServoSpec, fault: Fault, asked: str) -> BusError:
        """Return the error that says who failed at what, and how."""
        silent = fault.kind is FaultKind.SILENT
        return _ERRORS[fault.kind](
            fault.found,
            self._guess() if silent else "",
            servo=str(servo),
            servo_id=servo.id,
            port=self.port.name,
            asked=asked,
            sent=fault.sent,
            received=fault.received,
        )

    def _guess(self) -> str:
        """Return where to look, from who else on the chain has answered when last asked."""
        asked = {i: counts for i, counts in self.statistics.items() if counts.asked}
        silent = [i for i, counts in asked.items() if counts.lost_in_a_row]
        answering = [i for i, counts in asked.items() if not counts.lost_in_a_row]
        return silence_hint(self._chain, answering, silent) if answering else ""

    def _answered(self, servo: ServoSpec, reply: Reply, asked: str) -> bytes:
        if isinstance(reply, Fault):
            raise self.error(servo, reply, asked)
        return reply.data

    def _believed(
        self,
        servo: ServoSpec,
        question: Callable[[], Reply],
        confirm: Callable[[Status], bool] | None,
    ) -> Reply:
        """Put a question once; an answer that may be another's counts only once confirmed."""
        reply = self._once(servo, question)
        if isinstance(reply, Fault) or not (reply.doubtful or (self.port.trust.wary and confirm)):
            return reply
        if confirm is None:  # nothing to compare it with: ask when nothing is owed any more
            self.driver(servo).exchange.wait_out((servo.id,))
            return self._once(servo, question)
        if confirm(reply):
            return reply
        return Fault(servo.id, FaultKind.GARBLED, "gave an answer that did not hold when checked")

    def _once(self, servo: ServoSpec, question: Callable[[], Reply]) -> Reply:
        started_s = self.port.clock.now_s()
        reply = question()
        self._note(servo, reply, self.port.clock.now_s() - started_s)
        return reply

    def _all_believed(
        self, servos: Sequence[ServoSpec], spans: Mapping[int, Span], *, steady: bool
    ) -> dict[int, Reply]:
        replies = self._all_once(servos, spans)
        if not (steady and self.port.trust.wary):
            return replies
        answered = [servo for servo in servos if isinstance(replies[servo.id], Status)]
        seconds = self._all_once(answered, spans)
        return replies | {i: _agreed(replies[i], second) for i, second in seconds.items()}

    def _all_once(self, servos: Sequence[ServoSpec], spans: Mapping[int, Span]) -> dict[int, Reply]:
        now_s = self.port.clock.now_s()
        replies: dict[int, Reply] = {}
        groups: dict[Family, dict[int, Span]] = {}
        for servo in servos:
            excuse = self._absence.excused(servo.id, now_s)
            if excuse:
                replies[servo.id] = excuse
            else:
                groups.setdefault(servo.table.family, {})[servo.id] = spans[servo.id]
        for family, group in groups.items():
            started_s = self.port.clock.now_s()
            heard = gather(self.drivers[family], group)
            took_s = self.port.clock.now_s() - started_s
            for servo in servos:
                if servo.id in heard:
                    self._note(servo, heard[servo.id], took_s)
            replies |= heard
        return replies

    def _worth_repeating(self, servo: ServoSpec, reply: Reply) -> bool:
        if not _is_lost(reply) or self._absence.is_deaf(servo.id):
            return False
        silent = isinstance(reply, Fault) and reply.kind is FaultKind.SILENT
        return not (silent and self.driver(servo).repeated_itself)

    def _note(self, servo: ServoSpec, reply: Reply, took_s: float) -> None:
        self.statistics[servo.id].note(reply, took_s)
        self._absence.note(reply, self.port.clock)
        if isinstance(reply, Status):
            bits = reply.alarm_bits
            self.alarms[servo.id] = servo.table.decode_alarms(bits) if bits else _NO_ALARMS


def _is_lost(reply: Reply) -> bool:
    return isinstance(reply, Fault) and reply.kind is not FaultKind.REFUSED


def _agreed(first: Reply, second: Reply) -> Reply:
    """Return what two readings of the same bytes say, if they say the same."""
    if isinstance(first, Fault) or isinstance(second, Fault) or first.data == second.data:
        return second
    return Fault(first.servo_id, FaultKind.GARBLED, "gave two answers that differ")

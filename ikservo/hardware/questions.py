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
from ikservo.hardware.plan import Round
from ikservo.hardware.servo import ServoSpec
from ikservo.hardware.statistics import ServoStatistics
from ikservo.registers import Alarm, Family

__all__ = ["Questions"]

_ERRORS: Mapping[FaultKind, type[BusError]] = {
    FaultKind.SILENT: ServoSilentError,
    FaultKind.GARBLED: BadReplyError,
    FaultKind.REFUSED: ServoRefusedError,
}
_WELL: frozenset[Alarm] = frozenset()


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
        self._tables = {servo.id: servo.table for servo in servos}
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
        for left in reversed(range(self.retries)):
            if not _is_lost(reply):
                break
            self.statistics[servo.id].retried += 1
            if left == 0:
                self.port.patience.insist()
            reply = self._believed(servo, question, confirm)
        return self._answered(servo, reply, asked)

    def many(self, step: Round) -> tuple[dict[int, bytes], dict[int, BusError]]:
        """Read a span of each of many servos' memories, with as few questions as can be.

        Those whose answers are lost are asked once more together; those that have been deaf for
        long are asked only every so often.

        Returns:
            The bytes of those who answered and the errors of those who did not.
        """
        replies = self._all_believed(step)
        if any(isinstance(reply, Fault) for reply in replies.values()):
            replies |= self._repeated(step, replies)
        data: dict[int, bytes] = {}
        errors: dict[int, BusError] = {}
        for servo in step.servos:
            reply = replies[servo.id]
            if isinstance(reply, Fault):
                errors[servo.id] = self.error(servo, reply, step.asked)
            else:
                data[servo.id] = reply.data
        return data, errors

    def _repeated(self, step: Round, replies: Mapping[int, Reply]) -> dict[int, Reply]:
        """Ask those once more who gave no answer, where there is hope."""
        again = [servo for servo in step.servos if self._worth_repeating(servo, replies[servo.id])]
        if not (again and self.retries):
            return {}
        for servo in again:
            self.statistics[servo.id].retried += 1
        return self._all_believed(step.only(again))

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
        return Fault(servo.id, FaultKind.GARBLED, "sent a reply that a second read did not confirm")

    def _once(self, servo: ServoSpec, question: Callable[[], Reply]) -> Reply:
        started_s = self.port.clock.now_s()
        reply = question()
        self._note(servo.id, reply, self.port.clock.now_s() - started_s)
        return reply

    def _all_believed(self, step: Round) -> dict[int, Reply]:
        replies = self._all_once(step)
        if not (step.steady and self.port.trust.wary):
            return replies
        answered = [servo for servo in step.servos if isinstance(replies[servo.id], Status)]
        seconds = self._all_once(step.only(answered))
        return replies | {i: _agreed(replies[i], second) for i, second in seconds.items()}

    def _all_once(self, step: Round) -> dict[int, Reply]:
        replies: dict[int, Reply] = self._excused(step) if self._absence else {}
        if replies:
            step = step.only([servo for servo in step.servos if servo.id not in replies])
        now_s = self.port.clock.now_s
        for family, spans in step.groups.items():
            started_s = now_s()
            heard = gather(self.drivers[family], spans)
            took_s = now_s() - started_s
            blamed = len(heard) == 1 or not all(map(_is_lost, heard.values()))
            for servo_id, reply in heard.items():
                self._note(servo_id, reply, took_s, blamed=blamed)
            replies |= heard
        return replies

    def _excused(self, step: Round) -> dict[int, Reply]:
        now_s = self.port.clock.now_s()
        excuses = {servo.id: self._absence.excused(servo.id, now_s) for servo in step.servos}
        return {servo_id: excuse for servo_id, excuse in excuses.items() if excuse}

    def _worth_repeating(self, servo: ServoSpec, reply: Reply) -> bool:
        if not _is_lost(reply) or self._absence.is_deaf(servo.id):
            return False
        silent = isinstance(reply, Fault) and reply.kind is FaultKind.SILENT
        return not (silent and self.driver(servo).repeated_itself)

    def _note(self, servo_id: int, reply: Reply, took_s: float, *, blamed: bool = True) -> None:
        """Count a reply; where many were asked and all are silent, it is the line's fault."""
        self.statistics[servo_id].note(reply, took_s)
        if blamed:
            self._absence.note(reply, self.port.clock)
        if isinstance(reply, Status):
            bits = reply.alarm_bits
            self.alarms[servo_id] = self._tables[servo_id].decode_alarms(bits) if bits else _WELL


def _is_lost(reply: Reply) -> bool:
    return isinstance(reply, Fault) and reply.kind is not FaultKind.REFUSED


def _agreed(first: Reply, second: Reply) -> Reply:
    """Return what two readings of the same bytes say, if they say the same."""
    if isinstance(first, Fault) or isinstance(second, Fault) or first.data == second.data:
        return second
    return Fault(first.servo_id, FaultKind.GARBLED, "sent two different replies")

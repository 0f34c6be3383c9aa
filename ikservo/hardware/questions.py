"""Putting questions until they are answered: repeats, counts, alarms, and errors with names."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass

from ikservo.errors import BadReplyError, BusError, ServoRefusedError, ServoSilentError
from ikservo.hardware.driver import Driver
from ikservo.hardware.drivers import driver_for
from ikservo.hardware.port import Port
from ikservo.hardware.replies import Fault, FaultKind, Reply
from ikservo.hardware.servo import ServoSpec
from ikservo.hardware.statistics import ServoStatistics
from ikservo.registers import Alarm, Family

__all__ = ["Questions", "Span"]

_ERRORS: Mapping[FaultKind, type[BusError]] = {
    FaultKind.SILENT: ServoSilentError,
    FaultKind.GARBLED: BadReplyError,
    FaultKind.REFUSED: ServoRefusedError,
}
_DEAF_AFTER = 3  # losses in a row after which a servo in a group is not asked twice any more


@dataclass(frozen=True, slots=True)
class Span:
    """A stretch of a servo's memory."""

    address: int
    size: int


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
        self.port, self.retries = port, retries
        self.statistics = {servo.id: ServoStatistics() for servo in servos}
        self.alarms: dict[int, frozenset[Alarm]] = {}
        families = {servo.table.family for servo in servos}
        self.drivers: dict[Family, Driver] = {
            family: driver_for(family, port, fast=fast) for family in families
        }

    def driver(self, servo: ServoSpec) -> Driver:
        """Return the driver that speaks the servo's dialect."""
        return self.drivers[servo.table.family]

    def one(
        self, servo: ServoSpec, asked: str, question: Callable[[], Reply], *, repeat: bool = True
    ) -> bytes:
        """Put a question to one servo until it is answered.

        Args:
            servo: Whom.
            asked: What, in words, for errors.
            question: Puts it once.
            repeat: It may be put again if the answer is lost.

        Raises:
            BusError: No usable answer, or a refusal.
        """
        reply = self._once(servo, question)
        for _ in range(self.retries if repeat else 0):
            if not _is_lost(reply):
                break
            self.statistics[servo.id].retried += 1
            reply = self._once(servo, question)
        if isinstance(reply, Fault):
            raise self._error(servo, reply, asked)
        return reply.data

    def many(
        self, servos: Sequence[ServoSpec], spans: Mapping[int, Span], asked: str
    ) -> tuple[dict[int, bytes], dict[int, BusError]]:
        """Read a span of many servos' memories, with one question to each family.

        Those whose answers are lost are asked once more together, unless they have been deaf for
        long.

        Returns:
            The bytes of those who answered and the errors of those who did not.
        """
        replies = self._all_once(servos, spans)
        again = [servo for servo in servos if self._worth_repeating(replies[servo.id])]
        if again and self.retries:
            for servo in again:
                self.statistics[servo.id].retried += 1
            replies |= self._all_once(again, spans)
        by_id = {servo.id: servo for servo in servos}
        faults = {i: reply for i, reply in replies.items() if isinstance(reply, Fault)}
        data = {i: reply.data for i, reply in replies.items() if not isinstance(reply, Fault)}
        return data, {i: self._error(by_id[i], fault, asked) for i, fault in faults.items()}

    def _once(self, servo: ServoSpec, question: Callable[[], Reply]) -> Reply:
        started_s = self.port.clock.now_s()
        reply = question()
        self._note(servo, reply, self.port.clock.now_s() - started_s)
        return reply

    def _all_once(self, servos: Sequence[ServoSpec], spans: Mapping[int, Span]) -> dict[int, Reply]:
        replies: dict[int, Reply] = {}
        for (family, span), group in _groups(servos, spans).items():
            started_s = self.port.clock.now_s()
            ids = [servo.id for servo in group]
            replies |= self.drivers[family].sync_read(ids, span.address, span.size)
            took_s = self.port.clock.now_s() - started_s
            for servo in group:
                self._note(servo, replies[servo.id], took_s)
        return replies

    def _worth_repeating(self, reply: Reply) -> bool:
        return _is_lost(reply) and self.statistics[reply.servo_id].lost_in_a_row < _DEAF_AFTER

    def _note(self, servo: ServoSpec, reply: Reply, took_s: float) -> None:
        self.statistics[servo.id].note(reply, took_s)
        if not isinstance(reply, Fault):
            self.alarms[servo.id] = servo.table.decode_alarms(reply.alarm_bits)

    def _error(self, servo: ServoSpec, fault: Fault, asked: str) -> BusError:
        return _ERRORS[fault.kind](
            fault.found,
            servo=str(servo),
            servo_id=servo.id,
            port=self.port.name,
            asked=asked,
            sent=fault.sent,
            received=fault.received,
        )


def _is_lost(reply: Reply) -> bool:
    return isinstance(reply, Fault) and reply.kind is not FaultKind.REFUSED


def _groups(
    servos: Iterable[ServoSpec], spans: Mapping[int, Span]
) -> dict[tuple[Family, Span], list[ServoSpec]]:
    """Return the servos that one question can reach together."""
    groups: dict[tuple[Family, Span], list[ServoSpec]] = defaultdict(list)
    for servo in servos:
        groups[servo.table.family, spans[servo.id]].append(servo)
    return groups

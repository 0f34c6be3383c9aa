"""Requests with retries, confirmation and back-off for silent servos."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

from ikservo.clock import Clock
from ikservo.errors import BadReplyError, BusError, ServoRejectedError, ServoSilentError
from ikservo.hardware.driver import ProtocolDriver
from ikservo.hardware.packets import FaultKind, Reply, ReplyFault, Status
from ikservo.hardware.port import Port
from ikservo.hardware.read_plan import ReadBatch, batch_read
from ikservo.hardware.servo import ServoSpec, ServoStatistics
from ikservo.registers import Alarm, Family

__all__ = ["Requester", "SilenceBackoff", "make_driver", "silence_hint"]


_UNRESPONSIVE_AFTER = 3  # losses in a row
_PROBE_PERIOD_S = 0.25


class SilenceBackoff:
    """Decides whether a servo in a group is worth a question now.

    A servo that has lost three answers in a row is asked again every quarter of a second, until
    it answers; in between it has the fault of the last time.
    """

    def __init__(self) -> None:
        self._lost: dict[int, int] = {}
        self._last: dict[int, ReplyFault] = {}
        self._asked_s: dict[int, float] = {}

    def __bool__(self) -> bool:
        """Return whether anybody has lost an answer of late."""
        return bool(self._lost)

    def cached_fault(self, servo_id: int, now_s: float) -> ReplyFault | None:
        """Return the fault of a servo that need not be asked now, or None if it is to be asked."""
        if not self._lost or self._lost.get(servo_id, 0) < _UNRESPONSIVE_AFTER:
            return None
        if now_s - self._asked_s[servo_id] >= _PROBE_PERIOD_S:
            return None
        return self._last[servo_id]

    def is_unresponsive(self, servo_id: int) -> bool:
        """Return whether it has been silent for so long that a repeat is a waste of time."""
        return bool(self._lost) and self._lost.get(servo_id, 0) >= _UNRESPONSIVE_AFTER

    def record(self, reply: Reply, clock: Clock) -> None:
        """Remember whether a servo answered."""
        if isinstance(reply, ReplyFault) and reply.kind is not FaultKind.REFUSED:
            self._lost[reply.servo_id] = self._lost.get(reply.servo_id, 0) + 1
            self._last[reply.servo_id], self._asked_s[reply.servo_id] = reply, clock.now_s()
        elif self._lost:
            self._lost.pop(reply.servo_id, None)


def make_driver(
    family: Family, port: Port, *, fast: bool = True, bulk_ids: Collection[int] = ()
) -> ProtocolDriver:
    """Return a driver for a family of servos; its vendor's SDK is imported only now.

    Args:
        family: The dialect.
        port: The line.
        fast: Whether the family's fastest way to ask many servos is tried first.
        bulk_ids: Servos of protocol 1.0 that know bulk read.
    """
    if family is Family.DYNAMIXEL_2:
        from ikservo.hardware.dynamixel import DynamixelDriver  # noqa: PLC0415

        return DynamixelDriver(port, fast=fast)
    if family is Family.DYNAMIXEL_1:
        from ikservo.hardware.dynamixel import Dynamixel1Driver  # noqa: PLC0415

        return Dynamixel1Driver(port, bulk_ids)
    from ikservo.hardware.feetech import FeetechDriver  # noqa: PLC0415

    return FeetechDriver(port, can_sync_read=family is Family.FEETECH_STS)


def silence_hint(
    chain: Iterable[ServoSpec], answering: Collection[int], silent: Collection[int]
) -> str:
    """Return what to look at, from who answers and who does not.

    Args:
        chain: The servos in the order of the cable.
        answering: Ids that gave an answer.
        silent: Ids that did not.
    """
    asked = [servo for servo in chain if servo.id in answering or servo.id in silent]
    if not answering:
        return (
            "No servo answers. Check the power supply and the first cable; "
            "to try every baud rate: ikservo doctor"
        )
    first = next(place for place, servo in enumerate(asked) if servo.id in silent)
    mute = [servo.id for servo in asked if servo.id in silent]
    if first and all(servo.id in silent for servo in asked[first:]):
        heard = [servo.id for servo in asked if servo.id in answering]
        return (
            f"{_describe_silent(mute)}, {_format_ids(heard)} "
            f"{'answers' if len(heard) == 1 else 'answer'}: "
            f"check the cable from {_servo_label(asked[first - 1])} "
            f"to {_servo_label(asked[first])}."
        )
    its = "its" if len(mute) == 1 else "their"
    return f"{_describe_silent(mute)}, the others do. Check {its} connector, id and baud rate."


def _describe_silent(servo_ids: Sequence[int]) -> str:
    one = len(servo_ids) == 1
    return (
        f"Servo{'' if one else 's'} {_format_ids(servo_ids)} {'does' if one else 'do'} not answer"
    )


def _servo_label(servo: ServoSpec) -> str:
    return servo.name or str(servo)


def _format_ids(servo_ids: Sequence[int]) -> str:
    ids = sorted(servo_ids)
    if len(ids) > 2 and ids == list(range(ids[0], ids[-1] + 1)):
        return f"{ids[0]} to {ids[-1]}"
    *most, last = map(str, ids)
    return f"{', '.join(most)} and {last}" if most else last


_ERRORS: Mapping[FaultKind, type[BusError]] = {
    FaultKind.SILENT: ServoSilentError,
    FaultKind.GARBLED: BadReplyError,
    FaultKind.REFUSED: ServoRejectedError,
}
_NO_FAULT: frozenset[Alarm] = frozenset()


class Requester:
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
        self._absence = SilenceBackoff()
        self._tables = {servo.id: servo.table for servo in servos}
        bulk_ids = [servo.id for servo in servos if servo.table.bulk_read]
        self.drivers: dict[Family, ProtocolDriver] = {
            family: make_driver(family, port, fast=fast, bulk_ids=bulk_ids)
            for family in dict.fromkeys(servo.table.family for servo in servos)
        }

    def driver_of(self, servo: ServoSpec) -> ProtocolDriver:
        """Return the driver that speaks the servo's dialect."""
        return self.drivers[servo.table.family]

    def request(
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
            self.driver_of(servo).transceiver.wait_for_pending((servo.id,))
            return self._require_reply(servo, self._request_once(servo, question), asked)
        reply = self._request_confirmed(servo, question, confirm)
        for left in reversed(range(self.retries)):
            if not _is_lost(reply):
                break
            self.statistics[servo.id].retried += 1
            if left == 0:
                self.port.patience.use_longest()
            reply = self._request_confirmed(servo, question, confirm)
        return self._require_reply(servo, reply, asked)

    def request_many(self, step: ReadBatch) -> tuple[dict[int, bytes], dict[int, BusError]]:
        """Read a span of each of many servos' memories, with as few questions as can be.

        Those whose answers are lost are asked once more together; those that have been deaf for
        long are asked only every so often.

        Returns:
            The bytes of those who answered and the errors of those who did not.
        """
        replies = self._request_all_confirmed(step)
        if any(isinstance(reply, ReplyFault) for reply in replies.values()):
            replies |= self._retry_lost(step, replies)
        data: dict[int, bytes] = {}
        errors: dict[int, BusError] = {}
        for servo in step.servos:
            reply = replies[servo.id]
            if isinstance(reply, ReplyFault):
                errors[servo.id] = self.make_error(servo, reply, step.asked)
            else:
                data[servo.id] = reply.data
        return data, errors

    def _retry_lost(self, step: ReadBatch, replies: Mapping[int, Reply]) -> dict[int, Reply]:
        """Ask those once more who gave no answer, where there is hope."""
        again = [servo for servo in step.servos if self._should_retry(servo, replies[servo.id])]
        if not (again and self.retries):
            return {}
        for servo in again:
            self.statistics[servo.id].retried += 1
        return self._request_all_confirmed(step.restricted_to(again))

    def make_error(self, servo: ServoSpec, fault: ReplyFault, asked: str) -> BusError:
        """Return the error that says who failed at what, and how."""
        silent = fault.kind is FaultKind.SILENT
        return _ERRORS[fault.kind](
            fault.found,
            self._diagnose_silence() if silent else "",
            servo=str(servo),
            servo_id=servo.id,
            port=self.port.name,
            asked=asked,
            sent=fault.sent,
            received=fault.received,
        )

    def _diagnose_silence(self) -> str:
        """Return where to look, from who else on the chain has answered when last asked."""
        asked = {i: counts for i, counts in self.statistics.items() if counts.asked}
        silent = [i for i, counts in asked.items() if counts.lost_in_a_row]
        answering = [i for i, counts in asked.items() if not counts.lost_in_a_row]
        return silence_hint(self._chain, answering, silent) if answering else ""

    def _require_reply(self, servo: ServoSpec, reply: Reply, asked: str) -> bytes:
        if isinstance(reply, ReplyFault):
            raise self.make_error(servo, reply, asked)
        return reply.data

    def _request_confirmed(
        self,
        servo: ServoSpec,
        question: Callable[[], Reply],
        confirm: Callable[[Status], bool] | None,
    ) -> Reply:
        """Put a question once; an answer that may be another's counts only once confirmed."""
        reply = self._request_once(servo, question)
        if isinstance(reply, ReplyFault) or not (
            reply.doubtful or (self.port.trust.suspect and confirm)
        ):
            return reply
        if confirm is None:  # nothing to compare it with: ask when nothing is owed any more
            self.driver_of(servo).transceiver.wait_for_pending((servo.id,))
            return self._request_once(servo, question)
        if confirm(reply):
            return reply
        return ReplyFault(
            servo.id, FaultKind.GARBLED, "sent a reply that a second read did not confirm"
        )

    def _request_once(self, servo: ServoSpec, question: Callable[[], Reply]) -> Reply:
        started_s = self.port.clock.now_s()
        reply = question()
        self._record_reply(servo.id, reply, self.port.clock.now_s() - started_s)
        return reply

    def _request_all_confirmed(self, step: ReadBatch) -> dict[int, Reply]:
        replies = self._request_all_once(step)
        if not (step.is_static and self.port.trust.suspect):
            return replies
        answered = [servo for servo in step.servos if isinstance(replies[servo.id], Status)]
        seconds = self._request_all_once(step.restricted_to(answered))
        return replies | {i: _merge_readings(replies[i], second) for i, second in seconds.items()}

    def _request_all_once(self, step: ReadBatch) -> dict[int, Reply]:
        replies: dict[int, Reply] = self._cached_faults(step) if self._absence else {}
        if replies:
            step = step.restricted_to([servo for servo in step.servos if servo.id not in replies])
        now_s = self.port.clock.now_s
        for family, spans in step.groups.items():
            started_s = now_s()
            heard = batch_read(self.drivers[family], spans)
            took_s = now_s() - started_s
            blamed = len(heard) == 1 or not all(map(_is_lost, heard.values()))
            for servo_id, reply in heard.items():
                self._record_reply(servo_id, reply, took_s, blamed=blamed)
            replies |= heard
        return replies

    def _cached_faults(self, step: ReadBatch) -> dict[int, Reply]:
        now_s = self.port.clock.now_s()
        excuses = {servo.id: self._absence.cached_fault(servo.id, now_s) for servo in step.servos}
        return {servo_id: excuse for servo_id, excuse in excuses.items() if excuse}

    def _should_retry(self, servo: ServoSpec, reply: Reply) -> bool:
        if not _is_lost(reply) or self._absence.is_unresponsive(servo.id):
            return False
        silent = isinstance(reply, ReplyFault) and reply.kind is FaultKind.SILENT
        return not (silent and self.driver_of(servo).already_retried)

    def _record_reply(
        self, servo_id: int, reply: Reply, took_s: float, *, blamed: bool = True
    ) -> None:
        """Count a reply; where many were asked and all are silent, it is the line's fault."""
        self.statistics[servo_id].record(reply, took_s)
        if blamed:
            self._absence.record(reply, self.port.clock)
        if isinstance(reply, Status):
            bits = reply.alarm_bits
            self.alarms[servo_id] = (
                self._tables[servo_id].decode_alarms(bits) if bits else _NO_FAULT
            )


def _is_lost(reply: Reply) -> bool:
    return isinstance(reply, ReplyFault) and reply.kind is not FaultKind.REFUSED


def _merge_readings(first: Reply, second: Reply) -> Reply:
    """Return what two readings of the same bytes say, if they say the same."""
    if isinstance(first, ReplyFault) or isinstance(second, ReplyFault) or first.data == second.data:
        return second
    return ReplyFault(first.servo_id, FaultKind.GARBLED, "sent two different replies")

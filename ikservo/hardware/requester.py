"""Requests with retries, confirmation and back-off for silent servos."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterable, Mapping, Sequence

from ikservo.clock import Clock
from ikservo.errors import BadReplyError, BusError, ServoRejectedError, ServoSilentError
from ikservo.hardware.packets import FaultKind, Reply, ReplyFault, Status
from ikservo.hardware.port import Port
from ikservo.hardware.protocols.driver import ProtocolDriver
from ikservo.hardware.register_batches import ReadBatch, batch_read
from ikservo.hardware.serial_ports import line_hint
from ikservo.hardware.servo import ServoSpec, ServoStatistics
from ikservo.registers import Alarm, Family

_UNRESPONSIVE_AFTER = 3  # consecutive lost replies
_PROBE_PERIOD_S = 0.25


class SilenceBackoff:
    """Schedule of the cycles in which a group read includes a silent servo.

    A servo that has not replied three times in succession is read every quarter of a second until
    it replies; in between, its last fault is reported again.
    """

    def __init__(self) -> None:
        self._lost: dict[int, int] = {}
        self._last: dict[int, ReplyFault] = {}
        self._requested_s: dict[int, float] = {}

    def __bool__(self) -> bool:
        """Check whether any servo has lost a reply recently."""
        return bool(self._lost)

    def cached_fault(self, servo_id: int, now_s: float) -> ReplyFault | None:
        """Return the last fault of a servo that is skipped now; None if the servo is to be read."""
        if not self._lost or self._lost.get(servo_id, 0) < _UNRESPONSIVE_AFTER:
            return None
        if now_s - self._requested_s[servo_id] >= _PROBE_PERIOD_S:
            return None
        return self._last[servo_id]

    def is_unresponsive(self, servo_id: int) -> bool:
        """Check whether a servo has been silent for so long that a retry would waste time."""
        return bool(self._lost) and self._lost.get(servo_id, 0) >= _UNRESPONSIVE_AFTER

    def record(self, reply: Reply, clock: Clock) -> None:
        """Record whether a servo replied."""
        if isinstance(reply, ReplyFault) and reply.kind is not FaultKind.REFUSED:
            self._lost[reply.servo_id] = self._lost.get(reply.servo_id, 0) + 1
            self._last[reply.servo_id], self._requested_s[reply.servo_id] = reply, clock.now_s()
        elif self._lost:
            self._lost.pop(reply.servo_id, None)


def make_driver(
    family: Family, port: Port, *, fast: bool = True, bulk_ids: Collection[int] = ()
) -> ProtocolDriver:
    """Make a driver for a family of servos; the vendor's SDK is imported on this call.

    Servos in ``bulk_ids`` have protocol 1.0 and support bulk read.
    """
    if family is Family.DYNAMIXEL_2:
        from ikservo.hardware.protocols.dynamixel import DynamixelDriver  # noqa: PLC0415

        return DynamixelDriver(port, fast=fast)
    if family is Family.DYNAMIXEL_1:
        from ikservo.hardware.protocols.dynamixel import Dynamixel1Driver  # noqa: PLC0415

        return Dynamixel1Driver(port, bulk_ids)
    from ikservo.hardware.protocols.feetech import FeetechDriver  # noqa: PLC0415

    return FeetechDriver(port, can_sync_read=family is Family.FEETECH_STS)


def silence_hint(
    chain: Iterable[ServoSpec], replying: Collection[int], silent: Collection[int]
) -> str:
    """Return a hint on what to check, based on which servos along the cable reply."""
    requested = [servo for servo in chain if servo.id in replying or servo.id in silent]
    if not replying:
        return (
            "No servo answers. Check the power supply and the first cable; "
            "to try all baud rates: ikservo doctor"
        )
    first = next(place for place, servo in enumerate(requested) if servo.id in silent)
    silent_ids = [servo.id for servo in requested if servo.id in silent]
    if first and all(servo.id in silent for servo in requested[first:]):
        replying_ids = [servo.id for servo in requested if servo.id in replying]
        return (
            f"{_describe_silent(silent_ids)}; {_format_ids(replying_ids)} "
            f"{'answers' if len(replying_ids) == 1 else 'answer'}. "
            f"Check the cable from {_servo_label(requested[first - 1])} "
            f"to {_servo_label(requested[first])}."
        )
    its = "its" if len(silent_ids) == 1 else "their"
    return (
        f"{_describe_silent(silent_ids)}; the others do. Check {its} connector, id and baud rate."
    )


def _describe_silent(servo_ids: Sequence[int]) -> str:
    if len(servo_ids) == 1:
        return f"Servo {servo_ids[0]} does not answer"
    return f"Servos {_format_ids(servo_ids)} do not answer"


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
    """Sender of requests to the servos of one port, in their protocols.

    Attributes:
        port: The port.
        retries: The number of repetitions of a repeatable request.
        statistics: The reply statistics of each servo.
        alarms: The alarms in the latest reply of each servo.
    """

    def __init__(
        self, port: Port, servos: Sequence[ServoSpec], retries: int, *, fast: bool
    ) -> None:
        self.port, self.retries, self._chain = port, retries, tuple(servos)
        self.statistics = {servo.id: ServoStatistics() for servo in servos}
        self.alarms: dict[int, frozenset[Alarm]] = {}
        self._backoff = SilenceBackoff()
        self._tables = {servo.id: servo.table for servo in servos}
        bulk_ids = [servo.id for servo in servos if servo.table.bulk_read]
        self.drivers: dict[Family, ProtocolDriver] = {
            family: make_driver(family, port, fast=fast, bulk_ids=bulk_ids)
            for family in dict.fromkeys(servo.table.family for servo in servos)
        }

    def driver_of(self, servo: ServoSpec) -> ProtocolDriver:
        """Return the driver for the servo's protocol."""
        return self.drivers[servo.table.family]

    def request(
        self,
        servo: ServoSpec,
        request: str,
        exchange: Callable[[], Reply],
        *,
        repeat: bool = True,
        confirm: Callable[[Status], bool] | None = None,
    ) -> bytes:
        """Send one request, with retries.

        A request that may not be repeated is sent only when no earlier reply can be mistaken for
        the reply to it. ``confirm`` checks a doubtful reply; errors name the ``request``.

        Raises:
            BusError: There was no usable reply, or the servo refused.
        """
        if not repeat:
            self.driver_of(servo).transceiver.wait_for_pending((servo.id,))
            return self._require_reply(servo, self._request_once(servo, exchange), request)
        reply = self._request_confirmed(servo, exchange, confirm)
        for remaining in reversed(range(self.retries)):
            if not _is_lost(reply):
                break
            self.statistics[servo.id].retried += 1
            if remaining == 0:
                self.port.reply_timeout.use_maximum()
            reply = self._request_confirmed(servo, exchange, confirm)
        return self._require_reply(servo, reply, request)

    def request_many(self, step: ReadBatch) -> tuple[dict[int, bytes], dict[int, BusError]]:
        """Read one memory span of each of many servos, with as few requests as possible.

        Lost replies are requested together once more; servos that have been silent for long are
        polled at a reduced rate.

        Returns:
            The bytes of each servo that replied, and the errors of the others.
        """
        replies = self._request_all_confirmed(step)
        if any(isinstance(reply, ReplyFault) for reply in replies.values()):
            retried = [s for s in step.servos if self._should_retry(s, replies[s.id])]
            if retried and self.retries:
                for servo in retried:
                    self.statistics[servo.id].retried += 1
                replies |= self._request_all_confirmed(step.restricted_to(retried))
        data: dict[int, bytes] = {}
        errors: dict[int, BusError] = {}
        for servo in step.servos:
            reply = replies[servo.id]
            if isinstance(reply, ReplyFault):
                errors[servo.id] = self.make_error(servo, reply, step.description)
            else:
                data[servo.id] = reply.data
        return data, errors

    def make_error(self, servo: ServoSpec, fault: ReplyFault, request: str) -> BusError:
        """Return the error that names the servo, the request and the fault."""
        hint = self._diagnose_silence() if fault.kind is FaultKind.SILENT else ""
        if fault.kind is not FaultKind.REFUSED:
            hint = line_hint(self.port.name, hint)
        return _ERRORS[fault.kind](
            fault.found,
            hint,
            servo=str(servo),
            servo_id=servo.id,
            port=self.port.name,
            request=request,
            sent=fault.sent,
            received=fault.received,
        )

    def _diagnose_silence(self) -> str:
        """Return a hint that is based on the latest replies of the other servos on the cable."""
        requested = {i: counts for i, counts in self.statistics.items() if counts.requests}
        silent = [i for i, counts in requested.items() if counts.lost_in_a_row]
        replying = [i for i, counts in requested.items() if not counts.lost_in_a_row]
        return silence_hint(self._chain, replying, silent) if replying else ""

    def _require_reply(self, servo: ServoSpec, reply: Reply, request: str) -> bytes:
        if isinstance(reply, ReplyFault):
            raise self.make_error(servo, reply, request)
        return reply.data

    def _request_confirmed(
        self,
        servo: ServoSpec,
        exchange: Callable[[], Reply],
        confirm: Callable[[Status], bool] | None,
    ) -> Reply:
        """Send a request once; accept an ambiguous reply only if a second reading confirms it."""
        reply = self._request_once(servo, exchange)
        if isinstance(reply, ReplyFault) or not (
            reply.ambiguous or (self.port.health.suspect and confirm)
        ):
            return reply
        if confirm is None:  # a second reading cannot confirm this: repeat when no reply is pending
            self.driver_of(servo).transceiver.wait_for_pending((servo.id,))
            return self._request_once(servo, exchange)
        if confirm(reply):
            return reply
        return ReplyFault(
            servo.id, FaultKind.GARBLED, "sent a reply that a second read did not confirm"
        )

    def _request_once(self, servo: ServoSpec, exchange: Callable[[], Reply]) -> Reply:
        started_s = self.port.clock.now_s()
        reply = exchange()
        self._record_reply(servo.id, reply, self.port.clock.now_s() - started_s)
        return reply

    def _request_all_confirmed(self, step: ReadBatch) -> dict[int, Reply]:
        replies = self._request_all_once(step)
        if not (step.is_static and self.port.health.suspect):
            return replies
        replying = [servo for servo in step.servos if isinstance(replies[servo.id], Status)]
        seconds = self._request_all_once(step.restricted_to(replying))
        for servo_id, second in seconds.items():
            first = replies[servo_id]
            if (
                isinstance(first, Status)
                and isinstance(second, Status)
                and first.data != second.data
            ):
                fault = ReplyFault(servo_id, FaultKind.GARBLED, "sent two different replies")
                replies[servo_id] = fault
            else:
                replies[servo_id] = second
        return replies

    def _request_all_once(self, step: ReadBatch) -> dict[int, Reply]:
        replies: dict[int, Reply] = {}
        now_s = self.port.clock.now_s
        if self._backoff:
            at_s = now_s()
            faults = {s.id: self._backoff.cached_fault(s.id, at_s) for s in step.servos}
            replies |= {servo_id: fault for servo_id, fault in faults.items() if fault}
        if replies:
            step = step.restricted_to([servo for servo in step.servos if servo.id not in replies])
        for family, spans in step.groups.items():
            started_s = now_s()
            received = batch_read(self.drivers[family], spans)
            took_s = now_s() - started_s
            blamed = len(received) == 1 or not all(map(_is_lost, received.values()))
            for servo_id, reply in received.items():
                self._record_reply(servo_id, reply, took_s, blamed=blamed)
            replies |= received
        return replies

    def _should_retry(self, servo: ServoSpec, reply: Reply) -> bool:
        if not _is_lost(reply) or self._backoff.is_unresponsive(servo.id):
            return False
        silent = isinstance(reply, ReplyFault) and reply.kind is FaultKind.SILENT
        return not (silent and self.driver_of(servo).already_retried)

    def _record_reply(
        self, servo_id: int, reply: Reply, took_s: float, *, blamed: bool = True
    ) -> None:
        """Record a reply; if a whole group is silent, the line is at fault, not the servo."""
        self.statistics[servo_id].record(reply, took_s)
        if blamed:
            self._backoff.record(reply, self.port.clock)
        if isinstance(reply, Status):
            bits = reply.alarm_bits
            self.alarms[servo_id] = (
                self._tables[servo_id].decode_alarms(bits) if bits else _NO_FAULT
            )


def _is_lost(reply: Reply) -> bool:
    return isinstance(reply, ReplyFault) and reply.kind is not FaultKind.REFUSED

"""Request plans and motions over a connection; motions stop if the caller fails."""

from __future__ import annotations

from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from typing import Any

from ikservo.apps.remote.client_connection import Connection, PendingCall
from ikservo.apps.remote.plan_fields import PathSamples, plan_from_fields
from ikservo.apps.remote.wire_messages import parse_result
from ikservo.arguments import check_callable
from ikservo.arm import MotionPlan, MotionProgress, StopKind, StopReason
from ikservo.arm.result_json import decode_fields
from ikservo.control.stop_requests import StopRequest
from ikservo.errors import IkservoError
from ikservo.planning.motions import MotionValue, motion_fields
from ikservo.planning.reports import OnProgress

_POLL_S = 0.02
_STOP_TIMEOUT_S = 5.0


class MotionCalls:
    """Requests for plans and motions to the server of an arm.

    Attributes:
        stop_request: Stops the arm, and shows which motions were requested before a stop.
    """

    def __init__(self, connection: Connection) -> None:
        self._connection = connection
        self.stop_request = RemoteStopRequest(connection)
        self._failures: list[Exception] = []

    def plan(self, motion: MotionValue[Any]) -> MotionPlan:
        """Request a plan, which stays on the server; the samples are fetched when needed."""
        found = self._connection.plan("plan", motion=motion_fields(motion))
        fields = parse_result(dict[str, Any], found)
        return plan_from_fields(fields, motion, self._fetch_samples)

    def run(self, service: str, on_progress: OnProgress | None, **arguments: object) -> object:
        """Request a motion and wait for its end; see ``await_result``."""
        check_callable("on_progress", on_progress)
        with self.reporting(on_progress):
            more = {} if on_progress is None else {"progress": True}
            return self.await_result(self.start(service, **arguments, **more), None)

    def start(self, service: str, **arguments: object) -> PendingCall:
        """Request a motion; any stop after the program has asked for the motion ends it."""
        count = self.stop_request.marked_count
        return self._connection.start(service, stop_count=count, **arguments)

    def await_result(
        self, pending: PendingCall, go_on: Callable[[], None] | None, poll_s: float = _POLL_S
    ) -> object:
        """Wait for the end of a motion; a signal or an error in the caller stops it.

        ``go_on`` is called periodically while waiting.

        Raises:
            IkservoError: The error of the motion.
            KeyboardInterrupt: Ctrl-C; the arm was braked and holds.
        """
        try:
            while not pending.wait(poll_s):
                self._raise_failure()
                if go_on is not None:
                    go_on()
            self._raise_failure()
        except BaseException as error:
            reason = StopReason(StopKind.CTRL_C, "Stopped by Ctrl-C.")
            if isinstance(error, Exception):
                why = error.message if isinstance(error, IkservoError) else str(error)
                text = f"The program failed: {why or type(error).__name__}"
                reason = StopReason(StopKind.FAULT, text)
            self.stop_request.set(reason)
            pending.wait(_STOP_TIMEOUT_S)
            raise
        return pending.result()

    def reporting(self, on_progress: OnProgress | None) -> AbstractContextManager[object]:
        """Return a context in which the progress of motions is reported.

        A Zenoh thread calls ``on_progress``; if that raises an error, ``await_result`` raises it.
        """
        check_callable("on_progress", on_progress)
        self._failures.clear()
        if on_progress is None:
            return nullcontext()

        def report(value: object) -> None:
            if isinstance(value, MotionProgress) and not self._failures:
                try:
                    on_progress(value)
                except Exception as error:  # raised by await_result
                    self._failures.append(error)

        return self._connection.subscribed("progress", report)

    def _fetch_samples(self, plan: str) -> PathSamples:
        return decode_fields(PathSamples, self._connection.plan("sample_plan", plan=plan))

    def _raise_failure(self) -> None:
        if self._failures:
            raise self._failures[0]


class RemoteStopRequest(StopRequest):
    """The stops of an arm on another machine, which performs and counts them.

    Attributes:
        count_here: The number of stops by this program, not counting cancelled motions.
    """

    def __init__(self, connection: Connection) -> None:
        super().__init__()
        self._connection = connection
        self.count_here = 0

    @property
    def count(self) -> int:
        """Number of stops of the arm by any program, as the other machine reports it."""
        return parse_result(int, self._connection.watch("stop_count"))

    def count_stop(self, reason: StopReason) -> None:
        """Count a stop by this program; requests made after it may reach the server first."""
        if reason.kind is not StopKind.CANCELLED:
            self.count_here += 1

    def set(self, reason: StopReason, signal: int = 0) -> None:
        """Request a stop from the other machine without waiting until the arm rests."""
        self.count_stop(reason)
        self._connection.stop(reason.text, reason.kind.name, wait=False)

"""The server of an arm: states, plans and motions, for one operator at a time."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack, suppress
from typing import TYPE_CHECKING, Any, cast

from ikservo.apps.remote import key_expressions as keys
from ikservo.apps.remote.plan_fields import PlanRegistry
from ikservo.apps.remote.request_queue import RequestQueue
from ikservo.apps.remote.services import (
    MOTIONS,
    STREAMED,
    WATCH,
    AtSpeed,
    Jog,
    OfMotion,
    OfPlan,
    parse_arguments,
)
from ikservo.apps.remote.setpoint_inbox import SetpointInbox, run_follow, run_jog, run_stream
from ikservo.apps.remote.wire_messages import (
    MAX_SETPOINT_BYTES,
    Announcement,
    ServiceRequest,
    Setpoint,
    decode,
    encode,
)
from ikservo.arm import MotionProgress, StopKind, StopReason
from ikservo.arm.result_json import encode_fields, encode_value
from ikservo.arm.service import ArmService, ServableArm
from ikservo.clock import Clock
from ikservo.errors import IkservoError, InputError
from ikservo.serving.control_client import StopResult
from ikservo.serving.replies import SAME_VERSION

if TYPE_CHECKING:
    import zenoh

_PROGRESS_PERIOD_S = 0.05
_STOP_KINDS = {
    kind.name: kind
    for kind in (StopKind.CTRL_C, StopKind.TERMINATED, StopKind.HANGUP, StopKind.PROGRAM,
                 StopKind.CANCELLED, StopKind.CLIENT)
}  # fmt: skip
_QUICK = ("lease", "release", "acknowledge", "disable_torque")
"""Requests of the operator that do not wait for the running motion."""


class ArmServer:
    """Server of an open arm in a Zenoh session, in separate threads, until it is closed.

    Motions run one at a time. If the operator of a running motion is silent for 0.3 s, or the
    connection is lost, the arm brakes, holds, and stays stopped until the stop is acknowledged.

    Args:
        session: The session; the caller closes it after the server.
        arm: The arm; the caller closes it after the server.
        name: The name under which it is served.
        rate_hz: The number of states per second that are published while there are subscribers.
        clock: The clock of the lease.

    Attributes:
        service: The service that clients use.
        lease: The lease of control.
    """

    def __init__(
        self,
        session: zenoh.Session,
        arm: ServableArm,
        name: str,
        rate_hz: float = 20.0,
        clock: Clock | None = None,
    ) -> None:
        self._session, self._arm, self.name, self._rate_hz = session, arm, name, rate_hz
        self._inbox = SetpointInbox()
        self.service = ArmService(arm, clock, self._inbox.close)
        self.lease, self._clock = self.service.lease, self.service.clock
        self._plans = PlanRegistry()
        self._closing = threading.Event()
        self._stack = ExitStack()
        self._news: dict[str, Any] = {}
        self._news_numbers = itertools.count(1)
        arm.runner.caches_states = True

    def __enter__(self) -> ArmServer:
        """Start serving."""
        session, name = self._session, self.name
        with ExitStack() as stack:
            for topic in ("state", "progress"):
                self._news[topic] = stack.enter_context(
                    session.declare_publisher(keys.news(name, topic), express=True)
                )
            for key, answer in (
                (keys.stop(name), self._answer_stop),
                (keys.watch(name, "*"), self._answer_watch),
                (keys.drive(name, "*"), self._answer_drive),
            ):
                queue = stack.enter_context(
                    RequestQueue(key, answer, self.check, self._requested, _QUICK)
                )
                stack.enter_context(session.declare_queryable(key, queue))
            setpoints, operators = keys.setpoint(name), keys.operator(name, "*")
            liveliness = session.liveliness()
            stack.enter_context(session.declare_subscriber(setpoints, self._on_setpoint))
            stack.enter_context(liveliness.declare_token(keys.server(name)))
            stack.enter_context(liveliness.declare_subscriber(operators, self._on_operator))
            for thread_name, run in (
                ("operator", lambda: self.service.watch_operator(self._closing)),
                ("states", self._publish_states),
            ):
                thread = threading.Thread(target=run, name=f"ikservo-{thread_name}", daemon=True)
                thread.start()
                stack.callback(thread.join, 2.0)
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Stop serving; a running motion is braked, and the arm holds."""
        if self._closing.is_set():
            return
        self._closing.set()
        self.service.close("The program that served the arm has ended.")
        self._stack.close()

    # requests

    def _requested(self, request: ServiceRequest) -> AbstractContextManager[None]:
        """Return the context for running a request; a stop after the request ends its motion.

        A stop while the request was on its way, or was waiting in the client, also ends the
        motion. A stop count above the arm's is capped; otherwise, the motion could survive stops.
        """
        background, count = self._arm.background, request.stop_count
        present = background.stop_count
        return background.requested(present if count is None else min(count, present))

    def check(self, request: ServiceRequest, service: str) -> None:
        """Check a request from the operator against the lease when it arrives.

        Raises:
            RefusedError: The lease refuses the request.
        """
        if service in (*MOTIONS, *STREAMED, "move", "execute", "acknowledge", "disable_torque"):
            self.lease.check_request(request.lease, request.number, request.sent_s)

    def _answer_watch(self, service: str, request: ServiceRequest) -> object:
        match service:
            case "clock":
                return self._clock.now_s()
            case "describe":
                return encode_fields(self.service.describe())
            case "health":
                return {**self.service.health(), "name": self.name}
            case "stop_count":
                return self._arm.background.stop_count
            case _ if service in WATCH:
                given = parse_arguments(WATCH[service].arguments, request.arguments)
                return WATCH[service].method(self._arm, **given.given())
            case _:
                raise _unknown(service)

    def _answer_stop(self, _: str, request: ServiceRequest) -> StopResult:
        given = request.arguments
        kind = _STOP_KINDS.get(str(given.get("kind")), StopKind.PROGRAM)
        own = self.lease.is_held_by(request.lease)
        who = "its operator" if own else "someone on another machine"
        text = " ".join(str(given.get("reason", ""))[:200].split()) or f"Stopped by {who}."
        return self.service.stop(StopReason(kind, text), lease=request.lease)

    def _answer_drive(self, service: str, request: ServiceRequest) -> object:
        match service:
            case "lease":
                operator = " ".join(str(request.arguments.get("operator", ""))[:80].split())
                holder = self.lease.acquire(operator or "somebody")
                return {"lease": holder.lease, "now_s": self._clock.now_s()}
            case "release":
                return self.service.release(request.lease)
            case "acknowledge":
                self._arm.acknowledge()
                return None
            case "disable_torque":
                return self._arm.disable_torque()
            case "sample_plan":
                name = parse_arguments(OfPlan, request.arguments).plan
                return encode_fields(self._plans.sample(name))
            case "plan":
                motion = parse_arguments(OfMotion, request.arguments).parse()
                return self._plans.add(self._arm.plan(motion))
            case _:
                return self._move(service, request)

    def _move(self, service: str, request: ServiceRequest) -> object:
        """Run a request that may move the arm; refuse an invalid one before the lease changes."""
        progress = bool(request.arguments.pop("progress", False))
        on_progress = self._publish_progress() if progress else None
        if service in ("move", "execute"):
            moved: Any
            if service == "move":
                moved = parse_arguments(OfMotion, request.arguments).parse()
            else:
                moved = self._plans.get(parse_arguments(OfPlan, request.arguments).plan)
            with self.lease.motion(request.lease):
                return self._arm.execute(moved, on_progress)
        if service in STREAMED:
            streamed = parse_arguments(STREAMED[service], request.arguments)
            self._inbox.begin(request.lease, request.number)
            with self.lease.motion(request.lease):
                if service == "jog":
                    jog = cast("Jog", streamed)
                    return run_jog(self._arm, self._inbox, jog.what, jog.speed)
                run = run_follow if service == "follow" else run_stream
                speed = cast("AtSpeed", streamed).speed
                return run(self._arm, self._inbox, speed, self.lease.timeout_s)
        if service not in MOTIONS:
            raise _unknown(service)
        options = parse_arguments(MOTIONS[service].arguments, request.arguments).given()
        if MOTIONS[service].reports_progress:
            options["on_progress"] = on_progress
        with self.lease.motion(request.lease):
            return MOTIONS[service].method(self._arm, **options)

    # the lease

    def _on_setpoint(self, sample: zenoh.Sample) -> None:
        with suppress(IkservoError):  # drop messages that are not setpoints
            setpoint = decode(Setpoint, sample.payload.to_bytes(), MAX_SETPOINT_BYTES)
            if self.lease.accept_setpoint(setpoint.lease, setpoint.number, setpoint.sent_s):
                self._inbox.put(setpoint)

    def _on_operator(self, sample: zenoh.Sample) -> None:
        holder = self.lease.holder
        gone = str(sample.kind).endswith("DELETE")
        if gone and holder and str(sample.key_expr).endswith(keys.operator_token(holder.lease)):
            self.service.lose(
                holder, f"The connection to {holder.operator} was lost; the arm holds its position."
            )

    # publishing

    def _publish(self, topic: str, value: object) -> None:
        message = Announcement(
            number=next(self._news_numbers), sent_s=self._clock.now_s(), value=encode_value(value)
        )
        self._news[topic].put(encode(message))

    def _publish_states(self) -> None:
        publisher = cast("zenoh.Publisher", self._news["state"])
        due_s = self._clock.now_s()
        while not self._closing.is_set():
            with suppress(Exception):  # silent servos are reported by the service "health"
                status: object = publisher.matching_status  # an object, despite the type stub
                if bool(getattr(status, "matching", status)):
                    self._publish("state", self._arm.where())
            due_s = max(due_s + 1.0 / self._rate_hz, self._clock.now_s())
            self._closing.wait(due_s - self._clock.now_s())

    def _publish_progress(self) -> Callable[[MotionProgress], None]:
        last_s = 0.0

        def publish(progress: MotionProgress) -> None:
            nonlocal last_s
            now_s = time.monotonic()
            if now_s - last_s >= _PROGRESS_PERIOD_S:
                last_s = now_s
                self._publish("progress", progress)

        return publish


def _unknown(service: str) -> InputError:
    return InputError(f"There is no service {service!r}.", SAME_VERSION)

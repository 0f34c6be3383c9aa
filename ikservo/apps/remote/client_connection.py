"""A client's connection to a served arm: requests, the lease of control, heartbeats."""

from __future__ import annotations

import itertools
import threading
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from typing import TYPE_CHECKING

from ikservo.apps.remote import key_expressions as keys
from ikservo.apps.remote.address import ArmAddress
from ikservo.apps.remote.wire_messages import (
    MAX_REQUEST_BYTES,
    MAX_SETPOINT_BYTES,
    Announcement,
    GrantedLease,
    ServiceRequest,
    Setpoint,
    arguments_of,
    decode,
    encode,
    parse_result,
    result_of,
)
from ikservo.apps.remote.zenoh_session import Certificate, ask, open_client, served_names, who_asks
from ikservo.arm.result_json import decode_value
from ikservo.errors import (
    IkservoError,
    LatchedStopError,
    LeaseLostError,
    PortError,
    PortLostError,
    RefusedError,
)
from ikservo.serving.lease import is_fresh

if TYPE_CHECKING:
    import zenoh

_SIGN_OF_LIFE_PERIOD_S = 0.05
_SYNC_PERIOD_S = 10.0
_MAX_ROUND_TRIP_S = 0.2  # largest round trip of the message that compares the clocks
_QUICK_S, _LONG_S = 5.0, 3600.0
_POLL_S = 0.05


def lost_connection(address: str) -> PortLostError:
    """Return the error for a request that another machine has not answered."""
    error = PortLostError(address, "no answer")
    error.command_hint = "Is that machine on and reachable, and is `ikservo serve` running there?"
    return error


class PendingCall:
    """A request that waits for its answer.

    Args:
        address: The address of the arm, for messages.
        on_lease_lost: Called if the answer says that this program does not control the arm.
    """

    def __init__(self, address: str, on_lease_lost: Callable[[], None]) -> None:
        self._address, self._on_lease_lost = address, on_lease_lost
        self._ended = threading.Event()
        self._data: bytes | None = None

    def on_reply(self, reply: zenoh.Reply) -> None:
        """Store the answer; called in a thread of Zenoh."""
        if reply.ok is not None:
            self._data = reply.ok.payload.to_bytes()

    def on_end(self) -> None:
        """Record that no more answers will come."""
        self._ended.set()

    def wait(self, timeout_s: float) -> bool:
        """Wait for the answer; return whether it has arrived."""
        return self._ended.wait(timeout_s)

    @property
    def done(self) -> bool:
        """Whether the request has been answered or can no longer be answered."""
        return self._ended.is_set()

    def result(self) -> object:
        """Return the result.

        Raises:
            PortLostError: The connection was lost before the answer.
            IkservoError: The error in the answer.
        """
        if self._data is None:
            raise lost_connection(self._address)
        try:
            return result_of(self._data)
        except LeaseLostError:
            self._on_lease_lost()
            raise
        except LatchedStopError as error:
            error.command_hint = (
                f"Check the arm, then: ikservo net acknowledge --port {self._address}"
            )
            raise


class Connection:
    """A connection to one served arm; closed by ``close``.

    Args:
        address: The address of the arm.
        certificate: The certificate of this end; None for a connection within this machine.

    Raises:
        PortError: Nothing listens at the address, or no arm of that name is served there.
    """

    def __init__(self, address: ArmAddress, certificate: Certificate | None) -> None:
        self.address = address
        self._stack = ExitStack()
        self._lock, self._lease, self._lease_stack = threading.RLock(), "", ExitStack()
        self._numbers = itertools.count(1)
        self._offset_s = self._synced_s = 0.0
        self._closed = threading.Event()
        self._stopping: tuple[PendingCall, ...] = ()
        with ExitStack() as stack:
            self._session = stack.enter_context(open_client([address.endpoint], certificate))
            setpoints = keys.setpoint(address.name)
            self._setpoints = stack.enter_context(
                self._session.declare_publisher(setpoints, express=True)
            )
            served = served_names(self._session, _QUICK_S)
            if address.name not in served:
                text = f"No arm named {address.name!r} is served at {address.endpoint}."
                raise PortError(text, f"Served there: {', '.join(served) or 'none'}.")
            self._compare_clocks()
            self._stack = stack.pop_all()

    def close(self) -> None:
        """Release the lease and close the session; a second call does nothing."""
        if not self._closed.is_set():
            self._closed.set()
            with self._stack, suppress(IkservoError):
                self.release()

    @property
    def is_open(self) -> bool:
        """Whether the connection is open."""
        return not self._closed.is_set()

    def watch(self, service: str, **arguments: object) -> object:
        """Send a request that moves nothing; return the result.

        Raises:
            IkservoError: The request failed on the server, or the connection is lost.
        """
        key, request = keys.watch(self.address.name, service), self._request(arguments)
        return self._call_again(key, request)

    def stop(self, reason: str, kind: str, *, wait: bool = True) -> object:
        """Stop the arm; without ``wait`` return at once, so that a signal handler may call it."""
        request = self._request({"reason": reason, "kind": kind}, lease=self._lease)
        key = keys.stop(self.address.name)
        if wait:
            return self._call_again(key, request)
        under_way = [each for each in self._stopping if not each.done]
        self._stopping = (*under_way, self._send(key, request, _QUICK_S))
        return None

    def acknowledge(self) -> None:
        """Acknowledge a stop, once this program's own stop requests have reached the server."""
        for each in self._stopping:
            each.wait(_QUICK_S)
        self.drive("acknowledge")

    def drive(self, service: str, **arguments: object) -> object:
        """Send a quick request as operator; return the result.

        Raises:
            IkservoError: The request failed on the server, or the connection is lost.
        """
        pending = self.start(service, stop_count=None, **arguments)
        while not pending.wait(_POLL_S):
            pass
        return pending.result()

    def start(
        self, service: str, *, stop_count: int | None = None, **arguments: object
    ) -> PendingCall:
        """Acquire the lease, then send a request as operator; see ``ServiceRequest``."""
        with self._lock:
            lease = self.acquire()
            request = self._request(
                arguments, lease=lease, number=next(self._numbers), stop_count=stop_count
            )
            return self._send(keys.drive(self.address.name, service), request, _LONG_S)

    def plan(self, service: str, **arguments: object) -> object:
        """Send a request as operator that needs no lease; return the result.

        Raises:
            RefusedError: This machine's certificate is not a certificate of an operator.
            IkservoError: The request failed on the server, or the connection is lost.
        """
        return self._ask_without_lease(service, arguments, _LONG_S)

    def send_setpoint(self, **goal: object) -> None:
        """Send a heartbeat with or without a goal; see ``Setpoint``."""
        with self._lock:
            if not self._lease:
                return
            setpoint = Setpoint.model_validate(
                {"lease": self._lease, "number": next(self._numbers),
                 "sent_s": self._server_now_s(), **goal}
            )  # fmt: skip
            self._setpoints.put(encode(setpoint, MAX_SETPOINT_BYTES))  # pyright: ignore[reportUnknownMemberType]

    def acquire(self) -> str:
        """Return the lease of control; acquire it if this program does not have it.

        Raises:
            RefusedError: Another program controls the arm, or this machine may not operate it.
        """
        with self._lock:
            if self._lease:
                return self._lease
            granted = self._ask_without_lease("lease", {"operator": who_asks()}, _QUICK_S)
            self._lease = parse_result(GrantedLease, granted).lease
            token = keys.operator(self.address.name, keys.operator_token(self._lease))
            stack = ExitStack()
            stack.enter_context(self._session.liveliness().declare_token(token))
            ended = threading.Event()
            threading.Thread(
                target=self._send_signs_of_life,
                args=(ended,),
                name="ikservo-sign-of-life",
                daemon=True,
            ).start()
            stack.callback(ended.set)
            self._lease_stack = stack
            return self._lease

    def _ask_without_lease(
        self, service: str, arguments: Mapping[str, object], timeout_s: float
    ) -> object:
        self._require_open()
        key = keys.drive(self.address.name, service)
        answers = ask(self._session, key, self._request(arguments), timeout_s)
        if not answers:
            self.watch("clock")  # raises if the link is cut
            hint = "With a watcher's certificate, an arm can only be watched and stopped."
            raise RefusedError(f"{self.address} does not let this machine drive it.", hint)
        return result_of(answers[0][1])

    def release(self) -> None:
        """Release the lease if this program has it."""
        with self._lock:
            lease, self._lease = self._lease, ""
            with self._lease_stack:  # closed even if the request fails
                if lease:
                    request = self._request({}, lease=lease, number=next(self._numbers))
                    key = keys.drive(self.address.name, "release")
                    self._send(key, request, 1.0).wait(1.0)

    def forget_lease(self) -> None:
        """Record that the lease was lost; the next request acquires another."""
        with self._lock:
            self._lease = ""
            self._lease_stack.close()

    @contextmanager
    def subscribed(self, topic: str, on_value: Callable[[object], None]) -> Generator[None]:
        """Call a function with each value of a topic in the ``with`` block, in a thread of Zenoh.

        Like goals, values are dropped if they are older than the dead-man timeout, repeated or
        overtaken.
        """
        newest = 0

        def on_sample(sample: zenoh.Sample) -> None:
            nonlocal newest
            with suppress(IkservoError):  # other messages are dropped
                news = decode(Announcement, sample.payload.to_bytes(), MAX_REQUEST_BYTES)
                if news.number > newest and is_fresh(news.sent_s, self._server_now_s()):
                    newest = news.number
                    on_value(decode_value(news.value))

        key = keys.news(self.address.name, topic)
        with self._session.declare_subscriber(key, on_sample):
            yield

    def _send_signs_of_life(self, ended: threading.Event) -> None:
        """Send heartbeats as long as this program has the lease."""
        while not ended.wait(_SIGN_OF_LIFE_PERIOD_S):
            with suppress(Exception):  # if the link is lost, the server notices
                self.send_setpoint()
                if time.monotonic() - self._synced_s > _SYNC_PERIOD_S:
                    self._synced_s = time.monotonic()
                    threading.Thread(target=self._compare_quietly, daemon=True).start()

    def _compare_quietly(self) -> None:
        with suppress(Exception):
            self._compare_clocks(attempts=1)

    def _compare_clocks(self, attempts: int = 5) -> None:
        """Estimate the server's clock from the fastest of several answers."""
        found: list[tuple[float, float]] = []
        for _ in range(attempts):
            before_s = time.monotonic()
            there_s = parse_result(float, self.watch("clock"))
            after_s = time.monotonic()
            found.append((after_s - before_s, there_s - (before_s + after_s) / 2.0))
        trip_s, offset_s = min(found)
        if trip_s > _MAX_ROUND_TRIP_S:
            raise PortError(
                f"{self.address} answers after {trip_s:.2f} s, which is too late to control an "
                f"arm.",
                f"At most {_MAX_ROUND_TRIP_S:g} s is allowed. Use a faster network.",
            )
        self._offset_s, self._synced_s = offset_s, time.monotonic()

    def _server_now_s(self) -> float:
        return time.monotonic() + self._offset_s

    def _request(
        self,
        arguments: Mapping[str, object],
        *,
        lease: str = "",
        number: int = 0,
        stop_count: int | None = None,
    ) -> bytes:
        return encode(
            ServiceRequest(
                lease=lease,
                number=number,
                sent_s=self._server_now_s(),
                stop_count=stop_count,
                arguments=arguments_of(arguments),
            )
        )

    def _send(self, key: str, request: bytes, timeout_s: float) -> PendingCall:
        import zenoh  # noqa: PLC0415  # an extra

        pending = PendingCall(str(self.address), self.forget_lease)
        handler = zenoh.handlers.Callback(pending.on_reply, pending.on_end)
        self._session.get(key, handler, payload=request, timeout=timeout_s)  # pyright: ignore[reportCallIssue, reportArgumentType, reportUnknownMemberType]
        return pending

    def _require_open(self) -> None:
        if not self.is_open:
            raise PortError(f"{self.address} was closed.", "Open the arm again: open_arm().")

    def _call_again(self, key: str, request: bytes) -> object:
        """Return the answer to a request that may be repeated; repeat it if the link was cut."""
        end_s = time.monotonic() + _QUICK_S
        while True:
            try:
                self._require_open()
                answers = ask(self._session, key, request, _QUICK_S)
                if not answers:
                    raise lost_connection(str(self.address))
                return result_of(answers[0][1])
            except PortLostError:
                if time.monotonic() > end_s or not self.is_open:
                    raise
                time.sleep(_POLL_S)

"""A node in a ROS 2 graph: publishers, subscriptions, trigger services."""

from __future__ import annotations

import os
import threading
import time
from collections import OrderedDict
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, ExitStack, nullcontext, suppress
from typing import TYPE_CHECKING, Any, TypeVar, cast

from ikservo.apps.remote.ros.wire import (
    Attachment,
    EndpointKind,
    NodeName,
    data_key,
    endpoint_token,
    node_token,
)
from ikservo.errors import IkservoError, InputError, RefusedError
from ikservo.ros_messages.arm_messages import RosMessage, Topic
from ikservo.ros_messages.message_types import TRIGGER, decode, encode, make

if TYPE_CHECKING:
    import zenoh

_MAX_MESSAGE_BYTES = 1024 * 1024
_MAX_PENDING = 16
_MAX_SENDERS = 256
_ENCODING = "application/cdr"

_T = TypeVar("_T")

Respond = Callable[[Any], None]
"""Function that sends the response to a request, a message of the service's type."""


class RosNode:
    """A ROS 2 node that exists until its stack is closed.

    Args:
        session: The Zenoh session.
        name: The name of the node.
        stack: Stack that undeclares everything when it is closed.
        warn: Called with the reason if a message is dropped.
        requested: Called when a message arrives; returns the context for handling it.
    """

    def __init__(
        self,
        session: zenoh.Session,
        name: NodeName,
        stack: ExitStack,
        warn: Callable[[str], None],
        requested: Callable[[], AbstractContextManager[None]] = nullcontext,
    ) -> None:
        self._session, self.name, self._stack, self._warn = session, name, stack, warn
        self._count = 0
        self._messages = _Worker(1, "ikservo-ros-messages", requested)  # handles messages in order
        self._services = _Worker(4, "ikservo-ros-services", requested)
        stack.callback(self._messages.close)
        stack.callback(self._services.close)
        self._announce(node_token(name))

    def publisher(self, topic: Topic) -> _Publisher:
        """Announce a topic, and return its publisher."""
        import zenoh.ext  # noqa: PLC0415  # an extra

        key = data_key(self.name, topic.name, topic.kind)
        publisher: Any
        if topic.latched:
            cache = zenoh.ext.CacheConfig(max_samples=1)
            publisher = zenoh.ext.declare_advanced_publisher(
                self._session, key, cache=cache, publisher_detection=True
            )
        else:
            publisher = self._session.declare_publisher(key, express=True)
        self._stack.enter_context(publisher)
        self._announce_endpoint(EndpointKind.PUBLISHER, topic)
        return _Publisher(publisher)

    def subscribe(self, topic: Topic, on_message: Callable[[Any], None]) -> None:
        """Announce a subscription; drop messages of another type with a warning."""
        senders = _Senders()

        def take(sample: zenoh.Sample) -> None:
            try:
                senders.check(_read_attachment(sample.attachment))
                on_message(decode(topic.kind, _bytes_of(sample.payload)))
            except IkservoError as error:
                self._warn(f"{topic.name}: {error.message}")

        def on_sample(sample: zenoh.Sample) -> None:
            self._messages.submit(take, sample)

        key = data_key(self.name, topic.name, topic.kind)
        self._stack.enter_context(self._session.declare_subscriber(key, on_sample))
        self._announce_endpoint(EndpointKind.SUBSCRIPTION, topic)

    def serve_trigger(self, name: str, action: Callable[[], str], *, always: bool = False) -> None:
        """Announce a service std_srvs/srv/Trigger.

        ``action`` returns the message for the response; its error becomes a response without
        success. If ``always``, every request is executed on arrival, even if repeated or without
        attachment, and ``action`` must not wait.
        """
        key = data_key(self.name, name, TRIGGER)

        def obey(query: zenoh.Query) -> None:
            response, asked = _trigger_response(action), Attachment(0, 0, bytes(16))
            with suppress(IkservoError):
                asked = _read_attachment(query.attachment)
            _reply(query, key, encode(f"{TRIGGER}_Response", response), asked)

        def answer(_: None, respond: Respond) -> None:
            respond(_trigger_response(action))

        if always:
            self._declare_service(name, TRIGGER, obey)
        else:
            self.serve(name, TRIGGER, answer)

    def serve(
        self,
        name: str,
        kind: str,
        on_request: Callable[[Any, Respond], None],
        *,
        in_order: bool = False,
    ) -> None:
        """Announce a service.

        ``on_request`` gets each request and a function that sends its response. If ``in_order``,
        requests are handled one by one, together with messages on topics.
        """
        worker = self._messages if in_order else self._services
        key, senders = data_key(self.name, name, kind), _Senders()

        def answer(query: zenoh.Query) -> None:
            try:
                asked = senders.check(_read_attachment(query.attachment))
                data = b"" if query.payload is None else _bytes_of(query.payload)
                request = None if kind == TRIGGER else decode(f"{kind}_Request", data)
            except IkservoError as error:
                self._warn(f"{name}: {error.message}")
                return
            on_request(request, lambda response: _reply(
                query, key, encode(f"{kind}_Response", response), asked))  # fmt: skip

        self._declare_service(name, kind, lambda query: worker.submit(answer, query))

    def _declare_service(
        self, name: str, kind: str, on_query: Callable[[zenoh.Query], None]
    ) -> None:
        key = data_key(self.name, name, kind)
        self._stack.enter_context(self._session.declare_queryable(key, on_query, complete=True))
        self._announce_endpoint(EndpointKind.SERVICE, Topic(name, kind))

    def _announce_endpoint(self, kind: EndpointKind, topic: Topic) -> None:
        self._count += 1
        self._announce(
            endpoint_token(
                self.name, self._count, kind, topic.name, topic.kind, latched=topic.latched
            )
        )

    def _announce(self, token: str) -> None:
        self._stack.enter_context(self._session.liveliness().declare_token(token))


class _Senders:
    """Number of the last message from each sender, with which older messages are refused."""

    def __init__(self) -> None:
        self._last: OrderedDict[bytes, int] = OrderedDict()
        self._lock = threading.Lock()

    def check(self, attachment: Attachment) -> Attachment:
        """Check the attachment of a message.

        Raises:
            RefusedError: The message is repeated, or was overtaken by a later one.
        """
        with self._lock:
            if attachment.sequence <= self._last.get(attachment.gid, -1):
                raise RefusedError("A message arrived twice.", "It was dropped.")
            self._last[attachment.gid] = attachment.sequence
            self._last.move_to_end(attachment.gid)
            if len(self._last) > _MAX_SENDERS:
                self._last.popitem(last=False)
        return attachment


class _Worker:
    """Handler of Zenoh messages in separate threads; drops messages if there are too many."""

    def __init__(
        self, threads: int, name: str, requested: Callable[[], AbstractContextManager[None]]
    ) -> None:
        self._requested = requested
        self._pool = ThreadPoolExecutor(threads, thread_name_prefix=name)
        self._free = threading.BoundedSemaphore(_MAX_PENDING)

    def submit(self, handle: Callable[[_T], None], received: _T) -> None:
        """Queue a task, unless too many are waiting."""
        if not self._free.acquire(blocking=False):
            return
        with suppress(RuntimeError, IkservoError):  # while closing, or if the arm is gone
            self._pool.submit(self._handle, self._requested(), handle, received)
            return
        self._free.release()

    def close(self) -> None:
        """Wait for running tasks."""
        self._pool.shutdown(cancel_futures=True)

    def _handle(
        self, requested: AbstractContextManager[None], handle: Callable[[_T], None], received: _T
    ) -> None:
        try:
            with requested:
                handle(received)
        finally:
            self._free.release()


class _Publisher:
    """Publisher of numbered and time-stamped messages on one topic."""

    def __init__(self, publisher: Any) -> None:  # noqa: ANN401  # plain or advanced
        self._publisher, self._gid, self._sequence = publisher, os.urandom(16), 0

    def publish(self, message: RosMessage) -> None:
        """Send a message."""
        self._sequence += 1
        attachment = Attachment(self._sequence, time.time_ns(), self._gid).to_bytes()
        self._publisher.put(message.data, encoding=_ENCODING, attachment=attachment)


def _trigger_response(action: Callable[[], str]) -> Any:  # noqa: ANN401  # a generated class
    try:
        success, text = True, action()
    except IkservoError as error:
        success, text = False, error.message
    except Exception as error:  # a failed request must be answered, too
        success, text = False, f"The request failed: {type(error).__name__}: {error}"
    return make(f"{TRIGGER}_Response", success=success, message=text)


def _reply(query: zenoh.Query, key: str, response: bytes, asked: Attachment) -> None:
    dated = Attachment(asked.sequence, time.time_ns(), asked.gid).to_bytes()
    with query, suppress(Exception):  # the client may be gone
        query.reply(key, response, encoding=_ENCODING, attachment=dated)  # pyright: ignore[reportUnknownMemberType]


def _read_attachment(attachment: zenoh.ZBytes | None) -> Attachment:
    return Attachment.from_bytes(b"" if attachment is None else attachment.to_bytes())


def _bytes_of(payload: zenoh.ZBytes) -> bytes:
    if len(cast("Any", payload)) > _MAX_MESSAGE_BYTES:
        raise InputError(
            "A message is too long.", f"At most {_MAX_MESSAGE_BYTES // 1024} KiB are read."
        )
    return payload.to_bytes()

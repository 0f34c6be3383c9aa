"""Queue of client requests, which are checked on arrival and answered in threads."""

from __future__ import annotations

import threading
from collections.abc import Callable, Collection
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, suppress
from typing import TYPE_CHECKING

from ikservo.apps.remote.wire_messages import (
    MAX_REQUEST_BYTES,
    ServiceRequest,
    decode,
    encode_failure,
    encode_result,
)
from ikservo.errors import IkservoError, InputError, RefusedError

if TYPE_CHECKING:
    import zenoh

_MAX_PENDING = 16  # limit of waiting requests; more are refused
_THREADS = 4


class RequestQueue:
    """Queue of the requests for one key expression; Zenoh calls it in a separate thread.

    Args:
        key: ``…/*`` for services by name, or the key of one service.
        answer: Runs the request for a service; returns the result.
        check: Refuses a request for a service on arrival.
        requested: Called with a request on arrival; returns the context for its answer.
        quick: Services of an operator that do not wait for earlier requests; all others of
            ``…/drive/*`` run one by one.
    """

    def __init__(
        self,
        key: str,
        answer: Callable[[str, ServiceRequest], object],
        check: Callable[[ServiceRequest, str], None],
        requested: Callable[[ServiceRequest], AbstractContextManager[None]],
        quick: Collection[str],
    ) -> None:
        self._key, self._answer, self._check, self._quick = key, answer, check, quick
        self._requested = requested
        self._driving = key.endswith("/drive/*")
        self._free = threading.BoundedSemaphore(_MAX_PENDING)
        self._several = ThreadPoolExecutor(_THREADS, thread_name_prefix="ikservo-request")
        self._single = ThreadPoolExecutor(1, thread_name_prefix="ikservo-drive")

    def __enter__(self) -> RequestQueue:
        """Return the queue; leaving the block waits for requests in progress."""
        return self

    def __exit__(self, *_: object) -> None:
        for pool in (self._several, self._single):
            pool.shutdown(cancel_futures=True)

    def __call__(self, query: zenoh.Query) -> None:
        """Check a request and queue it."""
        service = str(query.key_expr).rpartition("/")[2]
        try:
            data = b"" if query.payload is None else query.payload.to_bytes()
            request = decode(ServiceRequest, data, MAX_REQUEST_BYTES)
            if self._driving:
                if str(query.key_expr) != self._key.replace("*", service) or "*" in service:
                    raise InputError(
                        "A request can drive only one arm.", "Nothing was sent. Name the arm."
                    )
                self._check(request, service)
            if not self._free.acquire(blocking=False):
                raise RefusedError(
                    "The arm has too many requests.", "The request was not executed. Try again."
                )
        except IkservoError as error:
            self._reply(query, service, encode_failure(error))
            return
        waits = self._driving and service not in self._quick
        pool = self._single if waits else self._several
        with suppress(RuntimeError):  # raised while the queue is being closed
            pool.submit(self._work, query, service, request, self._requested(request))

    def _work(
        self,
        query: zenoh.Query,
        service: str,
        request: ServiceRequest,
        requested: AbstractContextManager[None],
    ) -> None:
        try:
            with requested:
                data = encode_result(self._answer(service, request))
        except BaseException as error:  # a request must not end this program
            data = encode_failure(error)
        finally:
            self._free.release()
        self._reply(query, service, data)

    def _reply(self, query: zenoh.Query, service: str, data: bytes) -> None:
        key = self._key.replace("*", service)
        with suppress(Exception), query:  # the client may be gone
            query.reply(key, data)  # pyright: ignore[reportUnknownMemberType]

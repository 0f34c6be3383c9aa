"""The web server: static files and one websocket."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import gc
import json
import socket
import sys
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from functools import partial
from importlib.resources import files
from typing import TYPE_CHECKING, Any, Generic, Protocol, TypeVar

import uvicorn
from pydantic_core import to_json
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import BaseRoute, Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from ikservo.apps.page.messages.message_fields import PageMessage
from ikservo.apps.page.messages.page_messages import MAX_MESSAGE_BYTES, BadMessageError, read_hello
from ikservo.apps.page.server.auth import (
    REQUEST_TIMEOUT_S,
    AccessTokens,
    ConnectionLimiter,
    OriginCheckMiddleware,
    Permission,
    new_nonce,
)
from ikservo.apps.page.server.downloads import DownloadOffers
from ikservo.apps.page.server.message_age_and_rate import (
    MessageFilter,
    RateLimitError,
    StaleMessageError,
    StalePressError,
)
from ikservo.clock import Clock
from ikservo.errors import IkservoError, PortError
from ikservo.remedies import in_page

if TYPE_CHECKING:
    from ikservo.apps.page.server.certificate import PageCertificate

_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}


def static_routes(index: str = "index.html") -> list[Route]:
    """Return the routes of the page's files, including the page itself."""

    async def serve_index(_: Request) -> Response:
        return _page_file_response(index)

    return [
        Route("/", serve_index, methods=["GET"]),
        Route("/page/{name}", _serve_asset, methods=["GET"]),
    ]


async def _serve_asset(request: Request) -> Response:
    return _page_file_response(request.path_params["name"])


def _page_file_response(name: str) -> Response:
    """Return one of the page's files; 404 for every other name."""
    page = files("ikservo.apps.page") / "static"
    known = {entry.name for entry in page.iterdir()}
    kind = _TYPES.get(name.rpartition(".")[2])
    if name not in known or kind is None:
        return PlainTextResponse("There is no such page.\n", status_code=404)
    return Response((page / name).read_bytes(), media_type=kind)


_HELLO_TIMEOUT_S = 2.0
_MIN_FRAME_PERIOD_S = 1.0 / 125.0  # least time between two scenes, even for fast screens
_SEND_TIMEOUT_S = 1.0 / 40.0  # on a slow network, send before the last scene is confirmed
_SLOW_CLIENT_S = 2.0  # a page that receives nothing for this long is dropped
_MAX_FRAMES_AHEAD = 2  # scenes in flight
_KEPT_BY_PAGE = ("scene", "status")
_MAX_CLIENTS = _MAX_UNAUTHENTICATED = 16
_MAX_NEW_CONNECTIONS = 96  # in the time for a request; a page opens seven
_UNAUTHORISED, _NONE_OPEN, _TOO_LATE, _CLOSED = 4401, 4404, 4408, 4410
_RATE_EXCEEDED, _FULL = 1008, 1013

# Limit per key, so that watching pages do not lock out controlling ones.
_FULL_TEXTS = {
    Permission.WATCH: f"{_MAX_CLIENTS} pages are already watching this arm.",
    Permission.CONTROL: f"{_MAX_CLIENTS} pages with the control address are open already.",
}

Frame = Mapping[str, object]


_MessageT = TypeVar("_MessageT", bound=PageMessage)
_ReceivedT_contra = TypeVar("_ReceivedT_contra", contravariant=True)


class SessionEndedError(IkservoError):
    """The arm of a client was closed, which ends the client's connection."""


class SessionBackend(Protocol[_ReceivedT_contra]):
    """Handler of the clients of a websocket; no method may block."""

    def connect(self, permission: Permission) -> int:
        """Register a client and return its number."""
        ...

    def disconnect(self, client_id: int) -> None:
        """Remove a client."""
        ...

    def receive(self, client_id: int, message: _ReceivedT_contra) -> None:
        """Handle a client's message.

        Raises:
            BadMessageError: The request is not permitted, or impossible now; the client gets the
                text.
            SessionEndedError: There is no session any more.
        """
        ...

    def frames(self, client_id: int) -> list[Frame]:
        """Return the frames for a client that are new since the last call; there may be none.

        Raises:
            SessionEndedError: There is no session any more.
        """
        ...


@dataclass(frozen=True, slots=True)
class PageChannel(Generic[_MessageT]):
    """A websocket to which pages connect.

    Attributes:
        path: The address; a name after it is the name of an arm.
        find: Returns the backend for an arm by its name; None if there is none.
        read: Parses and validates a message.
    """

    path: str
    find: Callable[[str], SessionBackend[_MessageT] | None]
    read: Callable[[str], _MessageT]


def make_app(
    channels: Sequence[PageChannel[Any]],
    keys: AccessTokens,
    clock: Clock,
    downloads: DownloadOffers | None = None,
    index: str = "index.html",
) -> Starlette:
    """Make the server's application, with the origin check."""
    routes: list[BaseRoute] = [*static_routes(index)]
    for channel in channels:
        handler = _WebSocketHandler(channel, keys, clock)
        routes.append(WebSocketRoute(channel.path, handler.handle))
        routes.append(WebSocketRoute(f"{channel.path}/{{arm}}", handler.handle))
    if downloads is not None:
        routes.append(Route("/download/{token}", downloads.serve, methods=["GET"]))
    return Starlette(routes=routes, middleware=[Middleware(OriginCheckMiddleware)])


class _WebSocketHandler(Generic[_MessageT]):
    """Authentication of clients, and their websocket sessions."""

    def __init__(self, channel: PageChannel[_MessageT], keys: AccessTokens, clock: Clock) -> None:
        self._channel, self._keys, self._clock = channel, keys, clock
        self._client_counts = dict.fromkeys(Permission, 0)
        self._unauthenticated: deque[WebSocket] = deque()

    async def handle(self, socket: WebSocket) -> None:
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await socket.accept()
            try:
                permission = await self._authenticate(socket)
            except TimeoutError:  # the page of a busy browser tries again
                await socket.close(_TOO_LATE, "The page did not prove its key in time.")
                return
            if permission is None:
                await socket.close(_UNAUTHORISED, "The page's key is not valid in this session.")
            elif self._client_counts[permission] >= _MAX_CLIENTS:
                await socket.close(_FULL, _FULL_TEXTS[permission])
            else:
                await self._connect(socket, permission)

    async def _authenticate(self, socket: WebSocket) -> Permission | None:
        """Authenticate the client (HMAC challenge) before sending anything.

        Raises:
            TimeoutError: The client does not answer.
        """
        if len(self._unauthenticated) >= _MAX_UNAUTHENTICATED:  # they must not lock others out
            await self._unauthenticated.popleft().close(_FULL, "Too many pages are opening.")
        self._unauthenticated.append(socket)
        nonce = new_nonce()
        try:
            await socket.send_text(json.dumps({"kind": "challenge", "nonce": nonce}))
            hello = read_hello(await asyncio.wait_for(socket.receive_text(), _HELLO_TIMEOUT_S))
        except (BadMessageError, KeyError):
            return None
        finally:
            with contextlib.suppress(ValueError):  # it may have been dropped as the oldest
                self._unauthenticated.remove(socket)
        return self._keys.authorise(nonce, hello.proof)

    async def _connect(self, socket: WebSocket, permission: Permission) -> None:
        """Run the session of an authenticated client until either side ends it."""
        backend = self._channel.find(socket.path_params.get("arm", ""))
        if backend is None:
            await socket.close(_NONE_OPEN, "No such arm is open.")
            return
        try:
            self._client_counts[permission] += 1
            client_id = backend.connect(permission)
            try:
                messages = MessageFilter(self._clock.now_s(), self._channel.read)
                await self._run_session(_ClientState(socket, client_id, backend, messages))
            finally:
                backend.disconnect(client_id)
                self._client_counts[permission] -= 1
        except SessionEndedError as error:
            await socket.close(_CLOSED, error.message)

    async def _run_session(self, state: _ClientState[_MessageT]) -> None:
        writing = asyncio.create_task(self._write_frames(state))
        reading = asyncio.create_task(self._read_messages(state))
        try:
            done, _ = await asyncio.wait({reading, writing}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in (reading, writing):
                task.cancel()
            await asyncio.gather(reading, writing, return_exceptions=True)
        for task in done:
            task.result()

    async def _read_messages(self, state: _ClientState[_MessageT]) -> None:
        while True:
            try:
                text = await state.socket.receive_text()
            except KeyError:  # the client sent bytes instead of text
                await state.socket.close(_RATE_EXCEEDED, "Text only.")
                return
            try:
                message = state.filter.accept(text, self._clock.now_s())
                state.backend.receive(state.client_id, message)
            except RateLimitError as error:
                await state.socket.close(_RATE_EXCEEDED, error.message)
                return
            except BadMessageError as error:
                if isinstance(error, StaleMessageError) and not isinstance(error, StalePressError):
                    continue  # the page itself shows that it receives nothing
                hint = in_page(error.command_hint)
                refusal = {"kind": "refused", "message": error.message, "hint": hint}
                if refusal not in state.outbox:
                    state.outbox.append(refusal)
            drawn = state.filter.seen > state.drawn
            if drawn or not state.filter.frames_in_flight:
                state.drawn = state.filter.seen
                state.ready.set()

    async def _write_frames(self, state: _ClientState[_MessageT]) -> None:
        """Send new frames whenever a scene was drawn, one per refresh of the screen.

        Only the changed fields of scenes and status are sent; the page keeps the rest. Scenes are
        numbered, so that the age of replies is known.
        """
        loop = asyncio.get_running_loop()
        while True:
            due_s = loop.time() + _MIN_FRAME_PERIOD_S
            frames: list[Frame] = [*state.outbox]
            state.outbox.clear()
            if state.filter.frames_in_flight < _MAX_FRAMES_AHEAD:
                frames += state.backend.frames(state.client_id)
            for frame in frames:
                kind = frame["kind"]
                sent = state.changed_fields(frame) if kind in _KEPT_BY_PAGE else frame
                if kind == "scene":
                    sent = {**sent, "seq": state.filter.record_sent(self._clock.now_s())}
                async with asyncio.timeout(_SLOW_CLIENT_S):  # unlike wait_for it makes no task
                    await state.socket.send_text(to_json(sent).decode())
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(_SEND_TIMEOUT_S):
                    await state.ready.wait()
            await asyncio.sleep(due_s - loop.time())
            state.ready.clear()


@dataclass(slots=True)
class _ClientState(Generic[_MessageT]):
    """State of one websocket session.

    Attributes:
        backend: Handles its messages.
        filter: Parses and checks its messages.
        drawn: The last scene that is confirmed as drawn.
        outbox: Frames to be sent before the next scene.
        ready: Set when the page has drawn a scene, or sends something with no scene in flight.
        known: The fields of each kind of frame that the page has.
    """

    socket: WebSocket
    client_id: int
    backend: SessionBackend[_MessageT]
    filter: MessageFilter[_MessageT]
    drawn: int = 0
    outbox: list[Frame] = field(default_factory=list[Frame])
    ready: asyncio.Event = field(default_factory=asyncio.Event)
    known: dict[object, Frame] = field(default_factory=dict[object, Frame])

    def changed_fields(self, frame: Frame) -> Frame:
        """Return the kind of a frame and its fields that the page does not have yet."""
        kind = frame["kind"]
        known = self.known.get(kind, {})
        self.known[kind] = {**known, **frame}
        changed = {k: v for k, v in frame.items() if k not in known or known[k] != v}
        return {"kind": kind, **changed}


_BYTES_A_CHARACTER = 4
USUAL_PORT = 8420
_USUAL_PORTS = range(USUAL_PORT, USUAL_PORT + 20)


class BoundAddress:
    """A bound and listening address, known before the server runs.

    Args:
        host: An IP address of this machine.
        port: A port, 0 for any free one; None: the usual one, or the next free one.
        certificate: Certificate for TLS; None for plain HTTP.

    Raises:
        PortError: The host is not an address of this machine, or the port is in use.
    """

    def __init__(
        self, host: str, port: int | None, certificate: PageCertificate | None = None
    ) -> None:
        self.certificate = certificate
        self.socket = _listening_socket(host, _USUAL_PORTS if port is None else (port,))
        self.is_unusual = port is None and self.socket.getsockname()[1] != USUAL_PORT

    @property
    def url(self) -> str:
        """The URL for a browser."""
        host, port = self.socket.getsockname()[:2]
        scheme = "http" if self.certificate is None else "https"
        return f"{scheme}://[{host}]:{port}" if ":" in host else f"{scheme}://{host}:{port}"


class _BoundedListener(socket.socket):
    """Listening socket that drops the oldest of too many new clients, also in a TLS handshake.

    Each client uses a file descriptor and 0.25 MB, which are freed late without garbage collection.
    """

    _new, _count = tuple[tuple[float, socket.socket], ...](), 0

    def accept(self) -> tuple[socket.socket, Any]:
        """Accept a connection."""
        accepted, address = super().accept()
        now_s = time.monotonic()
        since_s = now_s - REQUEST_TIMEOUT_S
        new = [pair for pair in self._new if pair[0] > since_s and pair[1].fileno() >= 0]
        if len(new) >= _MAX_NEW_CONNECTIONS:
            with contextlib.suppress(OSError):
                new.pop(0)[1].shutdown(socket.SHUT_RDWR)
        self._new, self._count = (*new, (now_s, accepted)), self._count + 1
        if self._count % _MAX_NEW_CONNECTIONS == 0:
            gc.collect()
        return accepted, address


def _listening_socket(host: str, ports: Sequence[int]) -> socket.socket:
    """Return a socket at the first port that no other program uses."""
    for port in ports:
        found = _BoundedListener(socket.AF_INET6 if ":" in host else socket.AF_INET)
        if sys.platform != "win32":  # on Windows it would share the port of another program
            found.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            found.bind((host, port))
            found.listen()  # clients that come early wait until the server runs
        except (OSError, OverflowError) as error:
            found.close()
            why, code = getattr(error, "strerror", None) or error, getattr(error, "errno", None)
            if code == errno.EADDRINUSE and port != ports[-1]:
                continue
            raise PortError(
                f"The page cannot be served at {host}, port {port}: {why}.",
                "Give an address of this machine with --listen; `ip address` shows them."
                if code == errno.EADDRNOTAVAIL
                else "Choose another port with --http-port, or 0 for any free port.",
            ) from error
        else:
            return found
    raise ValueError("no port was given")


def serve(app: Starlette, address: BoundAddress) -> None:
    """Serve until SIGINT or SIGTERM; call it in the main thread."""
    with contextlib.suppress(KeyboardInterrupt):
        _make_server(app, address).run(sockets=[address.socket])


@contextmanager
def serve_in_thread(app: Starlette, address: BoundAddress) -> Generator[str]:
    """Serve in a separate thread during the ``with`` block; yield the URL."""
    server = _make_server(app, address)
    thread = threading.Thread(target=server.run, args=([address.socket],), daemon=True)
    thread.start()
    try:
        yield address.url
    finally:
        server.should_exit = True
        thread.join()


class _PromptServer(uvicorn.Server):
    """Server that drops clients that do not finish the TLS handshake in time.

    A client counts as a connection only after the handshake, for which asyncio waits a minute.
    """

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start serving."""
        if self.config.ssl is not None:
            loop: Any = asyncio.get_running_loop()
            loop.create_server = partial(
                loop.create_server, ssl_handshake_timeout=REQUEST_TIMEOUT_S
            )
        await super().startup(sockets)


def _make_server(app: Starlette, address: BoundAddress) -> uvicorn.Server:
    path = None if address.certificate is None else address.certificate.path
    config = uvicorn.Config(
        app,
        log_level="error",  # no line for each client that does not speak HTTP
        lifespan="off",
        http=ConnectionLimiter,
        ws="websockets-sansio",
        ws_max_size=MAX_MESSAGE_BYTES * _BYTES_A_CHARACTER,
        ws_per_message_deflate=False,
        ws_ping_interval=5.0,
        ws_ping_timeout=5.0,
        timeout_graceful_shutdown=1,
        backlog=_MAX_NEW_CONNECTIONS,  # this many are accepted before any is dropped
        server_header=False,
        proxy_headers=False,
        ssl_certfile=path,
    )
    return _PromptServer(config)

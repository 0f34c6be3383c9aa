"""The web server: static files and one websocket."""

from __future__ import annotations

import asyncio
import contextlib
import errno
import json
import socket
import threading
from collections import deque
from collections.abc import Generator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from importlib.resources import files
from typing import Protocol

import uvicorn
from pydantic_core import to_json
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from ikservo.clock import Clock
from ikservo.errors import PortError
from ikservo.view.auth import (
    AccessTokens,
    ConnectionLimiter,
    OriginCheckMiddleware,
    Permission,
    new_nonce,
)
from ikservo.view.connection import MessageFilter, RateLimitError, StaleMessageError
from ikservo.view.messages import MAX_MESSAGE_BYTES, BadMessageError, Message, read_hello

__all__ = [
    "BoundAddress",
    "SessionBackend",
    "make_app",
    "serve",
    "serve_in_thread",
    "static_routes",
]


_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}


def static_routes() -> list[Route]:
    """Return the routes on which a browser finds the page."""
    return [
        Route("/", _serve_index, methods=["GET"]),
        Route("/page/{name}", _serve_asset, methods=["GET"]),
    ]


async def _serve_index(_: Request) -> Response:
    return _page_file_response("index.html")


async def _serve_asset(request: Request) -> Response:
    return _page_file_response(request.path_params["name"])


def _page_file_response(name: str) -> Response:
    """Return one of the page's files; what is no plain name of one does not exist."""
    page = files("ikservo.view") / "page"
    known = {entry.name for entry in page.iterdir()}
    kind = _TYPES.get(name.rpartition(".")[2])
    if name not in known or kind is None:
        return PlainTextResponse("There is no such page.\n", status_code=404)
    return Response((page / name).read_bytes(), media_type=kind)


_HELLO_TIMEOUT_S = 2.0
_MIN_FRAME_PERIOD_S = 1.0 / 125.0  # between two scenes, however fast a screen is
_SEND_TIMEOUT_S = 1.0 / 40.0  # a page that is far away gets a scene before it has drawn the last
_SLOW_CLIENT_S = 2.0  # a page that takes nothing for so long is dropped
_MAX_FRAMES_AHEAD = 2  # scenes that may be on their way
_MAX_CLIENTS = _MAX_UNAUTHENTICATED = 16
_UNAUTHORISED, _RATE_EXCEEDED, _FULL = 4401, 1008, 1013

Frame = Mapping[str, object]


class SessionBackend(Protocol):
    """Whoever is behind the socket; none of these may wait for anything."""

    def connect(self, right: Permission) -> int:
        """Let a visitor in and return its number."""
        ...

    def disconnect(self, visitor: int) -> None:
        """Forget a visitor."""
        ...

    def receive(self, visitor: int, message: Message) -> None:
        """Act on what a visitor says.

        Raises:
            IkservoError: It may not, or it makes no sense now; the words go back to it.
        """
        ...

    def frames(self, visitor: int) -> list[Frame]:
        """Return what is new for a visitor since the last time, maybe nothing."""
        ...


def make_app(audience: SessionBackend, keys: AccessTokens, clock: Clock) -> Starlette:
    """Return the server's routes behind its door.

    Args:
        audience: Who acts and answers.
        keys: What a visitor must know.
        clock: Dates messages.
    """
    live = _WebSocketHandler(audience, keys, clock)
    routes = [
        *static_routes(),
        WebSocketRoute("/live", live.handle),
    ]
    return Starlette(routes=routes, middleware=[Middleware(OriginCheckMiddleware)])


class _WebSocketHandler:
    """Meets visitors on their sockets."""

    def __init__(self, audience: SessionBackend, keys: AccessTokens, clock: Clock) -> None:
        self._audience, self._keys, self._clock = audience, keys, clock
        self._present = 0
        self._strangers: deque[WebSocket] = deque()

    async def handle(self, socket: WebSocket) -> None:
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await socket.accept()
            right = await self._authenticate(socket)
            if right is None:
                await socket.close(_UNAUTHORISED, "This page's key is not the one of this session.")
            elif self._present >= _MAX_CLIENTS:
                await socket.close(_FULL, "Too many visitors.")
            else:
                await self._accept_client(socket, right)

    async def _authenticate(self, socket: WebSocket) -> Permission | None:
        """Ask who is there; nothing is said to whoever cannot prove a right."""
        if len(self._strangers) >= _MAX_UNAUTHENTICATED:  # a crowd of them keeps nobody out
            await self._strangers.popleft().close(_FULL, "Too many strangers.")
        self._strangers.append(socket)
        nonce = new_nonce()
        try:
            await socket.send_text(json.dumps({"kind": "challenge", "nonce": nonce}))
            hello = read_hello(await asyncio.wait_for(socket.receive_text(), _HELLO_TIMEOUT_S))
        except (TimeoutError, BadMessageError, KeyError):
            return None
        finally:
            with contextlib.suppress(ValueError):  # it was the eldest of too many
                self._strangers.remove(socket)
        return self._keys.authorise(nonce, hello.proof)

    async def _accept_client(self, socket: WebSocket, right: Permission) -> None:
        self._present += 1
        visitor = self._audience.connect(right)
        try:
            await self._run_session(socket, visitor)
        finally:
            self._audience.disconnect(visitor)
            self._present -= 1

    async def _run_session(self, socket: WebSocket, visitor: int) -> None:
        talk = _ClientState(socket, visitor, MessageFilter(self._clock.now_s()))
        writing = asyncio.create_task(self._write_frames(talk))
        reading = asyncio.create_task(self._read_messages(talk))
        try:
            done, _ = await asyncio.wait({reading, writing}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in (reading, writing):
                task.cancel()
            await asyncio.gather(reading, writing, return_exceptions=True)
        for task in done:
            task.result()

    async def _read_messages(self, talk: _ClientState) -> None:
        while True:
            try:
                text = await talk.socket.receive_text()
            except KeyError:  # bytes where text belongs
                await talk.socket.close(_RATE_EXCEEDED, "Text only.")
                return
            try:
                message = talk.intake.accept(text, self._clock.now_s())
                self._audience.receive(talk.visitor, message)
            except RateLimitError as error:
                await talk.socket.close(_RATE_EXCEEDED, error.message)
                return
            except StaleMessageError:
                continue  # the page shows by itself that it hears nothing
            except BadMessageError as error:
                said = {"kind": "refused", "message": error.message, "hint": error.command_hint}
                talk.outbox.append(said)
            drawn = talk.intake.seen > talk.drawn
            if drawn or not talk.intake.frames_in_flight:
                talk.drawn = talk.intake.seen
                talk.turn.set()

    async def _write_frames(self, talk: _ClientState) -> None:
        """Send what is new whenever a scene is drawn, so that each refresh of a screen has one."""
        loop = asyncio.get_running_loop()
        while True:
            due_s = loop.time() + _MIN_FRAME_PERIOD_S
            frames: list[Frame] = [*talk.outbox]
            talk.outbox.clear()
            if talk.intake.frames_in_flight < _MAX_FRAMES_AHEAD:
                frames += self._audience.frames(talk.visitor)
            for frame in frames:
                await asyncio.wait_for(
                    talk.socket.send_text(self._number_frame(talk, frame)), _SLOW_CLIENT_S
                )
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(talk.turn.wait(), _SEND_TIMEOUT_S)
            await asyncio.sleep(due_s - loop.time())
            talk.turn.clear()

    def _number_frame(self, talk: _ClientState, frame: Frame) -> str:
        """Return a frame as text; scenes are counted, which dates what is said in answer."""
        if frame["kind"] == "scene":
            frame = {**frame, "seq": talk.intake.record_sent(self._clock.now_s())}
        return to_json(frame).decode()


@dataclass(slots=True)
class _ClientState:
    """What is said on one socket.

    Attributes:
        drawn: The last scene that is known to be drawn.
        turn: Set when the page has drawn one, or says something while it waits for none.
    """

    socket: WebSocket
    visitor: int
    intake: MessageFilter
    drawn: int = 0
    outbox: list[Frame] = field(default_factory=list[Frame])
    turn: asyncio.Event = field(default_factory=asyncio.Event)


_BYTES_A_CHARACTER = 4


class BoundAddress:
    """An address that is ours from now on, so that it can be told before the server runs.

    Args:
        host: An IP address of this machine.
        port: A port, or 0 for any that is free.

    Raises:
        PortError: It is no address of this machine, or in use.
    """

    def __init__(self, host: str, port: int) -> None:
        family = socket.AF_INET6 if ":" in host else socket.AF_INET
        self.socket = socket.socket(family, socket.SOCK_STREAM)
        self.socket.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            self.socket.bind((host, port))
            self.socket.listen()  # whoever comes before the server runs waits
        except (OSError, OverflowError) as error:
            self.socket.close()
            raise _cannot_serve(host, port, error) from error

    @property
    def url(self) -> str:
        """Return what a browser calls it."""
        host, port = self.socket.getsockname()[:2]
        return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def _cannot_serve(host: str, port: int, error: OSError | OverflowError) -> PortError:
    why, code = getattr(error, "strerror", None) or error, getattr(error, "errno", None)
    foreign = code == errno.EADDRNOTAVAIL
    return PortError(
        f"The page cannot be served at {host}, port {port}: {why}.",
        "Name one of this machine's own addresses with --listen; `ip address` shows them."
        if foreign
        else "Choose another port with --http, or 0 for any that is free.",
    )


def serve(app: Starlette, address: BoundAddress) -> None:
    """Serve until SIGINT or SIGTERM; the caller's thread is the main one."""
    with contextlib.suppress(KeyboardInterrupt):
        _make_server(app).run(sockets=[address.socket])


@contextmanager
def serve_in_thread(app: Starlette, address: BoundAddress) -> Generator[str]:
    """Serve in a separate thread during the block, for a program that goes on; yields the URL."""
    server = _make_server(app)
    thread = threading.Thread(target=server.run, args=([address.socket],), daemon=True)
    thread.start()
    try:
        yield address.url
    finally:
        server.should_exit = True
        thread.join()


def _make_server(app: Starlette) -> uvicorn.Server:
    config = uvicorn.Config(
        app,
        log_level="warning",
        lifespan="off",
        http=ConnectionLimiter,
        ws="websockets-sansio",
        ws_max_size=MAX_MESSAGE_BYTES * _BYTES_A_CHARACTER,
        ws_per_message_deflate=False,
        ws_ping_interval=5.0,
        ws_ping_timeout=5.0,
        timeout_graceful_shutdown=1,
        server_header=False,
        proxy_headers=False,
    )
    return uvicorn.Server(config)

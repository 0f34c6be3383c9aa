"""The page's server: static files, and one websocket on which everything is said."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections.abc import Mapping
from importlib.resources import files
from typing import Any, Protocol

from pydantic_core import to_json
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route, WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from ikservo.clock import Clock
from ikservo.view.server.door import Door
from ikservo.view.server.intake import Intake, StaleError, TooManyError
from ikservo.view.server.messages import BadMessageError, Message, read_hello
from ikservo.view.server.visitors import Keys, Right, new_nonce

__all__ = ["Audience", "application"]

_HELLO_S = 2.0
_FRAME_S = 1.0 / 60.0
_SLOW_S = 2.0  # a page that takes nothing for so long is dropped
_AHEAD = 2  # scenes that may be on their way
_MOST_VISITORS = 16
_NOT_YOU, _TOO_MUCH, _FULL = 4401, 1008, 1013

_TYPES = {"html": "text/html", "css": "text/css", "js": "text/javascript", "svg": "image/svg+xml"}

Frame = Mapping[str, object]


class Audience(Protocol):
    """Whoever is behind the socket; none of these may wait for anything."""

    def join(self, right: Right) -> int:
        """Let a visitor in and return its number."""
        ...

    def leave(self, visitor: int) -> None:
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


def application(audience: Audience, keys: Keys, clock: Clock) -> Starlette:
    """Return the server's routes behind its door.

    Args:
        audience: Who acts and answers.
        keys: What a visitor must know.
        clock: Dates messages.
    """
    live = _Live(audience, keys, clock)
    routes = [
        Route("/", _index, methods=["GET"]),
        Route("/page/{name}", _asset, methods=["GET"]),
        WebSocketRoute("/live", live.meet),
    ]
    return Starlette(routes=routes, middleware=[Middleware(Door)])


async def _index(_: Request) -> Response:
    return _page_file("index.html")


async def _asset(request: Request) -> Response:
    return _page_file(request.path_params["name"])


def _page_file(name: str) -> Response:
    """Return one of the page's files; what is no plain name of one does not exist."""
    page = files("ikservo.view") / "page"
    known = {entry.name for entry in page.iterdir()}
    kind = _TYPES.get(name.rpartition(".")[2])
    if name not in known or kind is None:
        return PlainTextResponse("There is no such page.\n", status_code=404)
    return Response((page / name).read_bytes(), media_type=kind)


class _Live:
    """Meets visitors on their sockets."""

    def __init__(self, audience: Audience, keys: Keys, clock: Clock) -> None:
        self._audience, self._keys, self._clock = audience, keys, clock
        self._present = 0

    async def meet(self, socket: WebSocket) -> None:
        if self._present >= _MOST_VISITORS:
            await socket.accept()
            await socket.close(_FULL, "Too many visitors.")
            return
        self._present += 1
        try:
            with contextlib.suppress(WebSocketDisconnect, RuntimeError):
                await self._greet(socket)
        finally:
            self._present -= 1

    async def _greet(self, socket: WebSocket) -> None:
        """Ask who is there; nothing is said to whoever cannot prove a right."""
        await socket.accept()
        nonce = new_nonce()
        await socket.send_text(json.dumps({"kind": "challenge", "nonce": nonce}))
        try:
            hello = read_hello(await asyncio.wait_for(socket.receive_text(), _HELLO_S))
            right = self._keys.right(nonce, hello.proof)
        except (TimeoutError, BadMessageError, KeyError):
            right = None
        if right is None:
            await socket.close(_NOT_YOU, "This page's key is not the one of this session.")
            return
        visitor = self._audience.join(right)
        try:
            await self._converse(socket, visitor)
        finally:
            self._audience.leave(visitor)

    async def _converse(self, socket: WebSocket, visitor: int) -> None:
        intake = Intake(self._clock.now_s())
        outbox: list[Frame] = []
        writing = asyncio.create_task(self._write(socket, visitor, intake, outbox))
        reading = asyncio.create_task(self._read(socket, visitor, intake, outbox))
        try:
            done, _ = await asyncio.wait({reading, writing}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in (reading, writing):
                task.cancel()
            await asyncio.gather(reading, writing, return_exceptions=True)
        for task in done:
            task.result()

    async def _read(
        self, socket: WebSocket, visitor: int, intake: Intake, outbox: list[Frame]
    ) -> None:
        while True:
            try:
                text = await socket.receive_text()
            except KeyError:  # bytes where text belongs
                await socket.close(_TOO_MUCH, "Text only.")
                return
            try:
                self._audience.receive(visitor, intake.accept(text, self._clock.now_s()))
            except TooManyError as error:
                await socket.close(_TOO_MUCH, error.message)
                return
            except StaleError:
                continue  # the page shows by itself that it hears nothing
            except BadMessageError as error:
                outbox.append({"kind": "refused", "message": error.message, "hint": error.hint})

    async def _write(
        self, socket: WebSocket, visitor: int, intake: Intake, outbox: list[Frame]
    ) -> None:
        """Send what is new, sixty times a second at most, and never ahead of what is drawn."""
        scene = 0
        loop = asyncio.get_running_loop()
        due_s = loop.time()
        while True:
            frames: list[Frame] = [*outbox]
            outbox.clear()
            if scene - intake.seen < _AHEAD:
                frames += self._audience.frames(visitor)
            for frame in frames:
                said: dict[str, Any] = dict(frame)
                if said["kind"] == "scene":
                    scene += 1
                    said["seq"] = scene
                    intake.note_sent(scene, self._clock.now_s())
                await asyncio.wait_for(socket.send_text(to_json(said).decode()), _SLOW_S)
            due_s = max(due_s + _FRAME_S, loop.time())
            await asyncio.sleep(due_s - loop.time())

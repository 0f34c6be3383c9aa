"""The page's server: static files, and one websocket on which everything is said."""

from __future__ import annotations

import asyncio
import contextlib
import json
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

from pydantic_core import to_json
from starlette.applications import Starlette
from starlette.middleware import Middleware
from starlette.routing import WebSocketRoute
from starlette.websockets import WebSocket, WebSocketDisconnect

from ikservo.clock import Clock
from ikservo.view.server.assets import assets
from ikservo.view.server.door import Door
from ikservo.view.server.intake import Intake, StaleError, TooManyError
from ikservo.view.server.messages import BadMessageError, Message, read_hello
from ikservo.view.server.visitors import Keys, Right, new_nonce

__all__ = ["Audience", "application"]

_HELLO_S = 2.0
_LEAST_S = 1.0 / 125.0  # between two scenes, however fast a screen is
_PATIENCE_S = 1.0 / 40.0  # a page that is far away gets a scene before it has drawn the last
_SLOW_S = 2.0  # a page that takes nothing for so long is dropped
_AHEAD = 2  # scenes that may be on their way
_MOST_VISITORS = _MOST_STRANGERS = 16
_NOT_YOU, _TOO_MUCH, _FULL = 4401, 1008, 1013

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
        *assets(),
        WebSocketRoute("/live", live.meet),
    ]
    return Starlette(routes=routes, middleware=[Middleware(Door)])


class _Live:
    """Meets visitors on their sockets."""

    def __init__(self, audience: Audience, keys: Keys, clock: Clock) -> None:
        self._audience, self._keys, self._clock = audience, keys, clock
        self._present = 0
        self._strangers: deque[WebSocket] = deque()

    async def meet(self, socket: WebSocket) -> None:
        with contextlib.suppress(WebSocketDisconnect, RuntimeError):
            await socket.accept()
            right = await self._greet(socket)
            if right is None:
                await socket.close(_NOT_YOU, "This page's key is not the one of this session.")
            elif self._present >= _MOST_VISITORS:
                await socket.close(_FULL, "Too many visitors.")
            else:
                await self._welcome(socket, right)

    async def _greet(self, socket: WebSocket) -> Right | None:
        """Ask who is there; nothing is said to whoever cannot prove a right."""
        if len(self._strangers) >= _MOST_STRANGERS:  # a crowd of them keeps nobody out
            await self._strangers.popleft().close(_FULL, "Too many strangers.")
        self._strangers.append(socket)
        nonce = new_nonce()
        try:
            await socket.send_text(json.dumps({"kind": "challenge", "nonce": nonce}))
            hello = read_hello(await asyncio.wait_for(socket.receive_text(), _HELLO_S))
        except (TimeoutError, BadMessageError, KeyError):
            return None
        finally:
            with contextlib.suppress(ValueError):  # it was the eldest of too many
                self._strangers.remove(socket)
        return self._keys.right(nonce, hello.proof)

    async def _welcome(self, socket: WebSocket, right: Right) -> None:
        self._present += 1
        visitor = self._audience.join(right)
        try:
            await self._converse(socket, visitor)
        finally:
            self._audience.leave(visitor)
            self._present -= 1

    async def _converse(self, socket: WebSocket, visitor: int) -> None:
        talk = _Conversation(socket, visitor, Intake(self._clock.now_s()))
        writing = asyncio.create_task(self._write(talk))
        reading = asyncio.create_task(self._read(talk))
        try:
            done, _ = await asyncio.wait({reading, writing}, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in (reading, writing):
                task.cancel()
            await asyncio.gather(reading, writing, return_exceptions=True)
        for task in done:
            task.result()

    async def _read(self, talk: _Conversation) -> None:
        while True:
            try:
                text = await talk.socket.receive_text()
            except KeyError:  # bytes where text belongs
                await talk.socket.close(_TOO_MUCH, "Text only.")
                return
            try:
                message = talk.intake.accept(text, self._clock.now_s())
                self._audience.receive(talk.visitor, message)
            except TooManyError as error:
                await talk.socket.close(_TOO_MUCH, error.message)
                return
            except StaleError:
                continue  # the page shows by itself that it hears nothing
            except BadMessageError as error:
                said = {"kind": "refused", "message": error.message, "hint": error.command_hint}
                talk.outbox.append(said)
            drawn = talk.intake.seen > talk.drawn
            if drawn or not talk.intake.under_way:
                talk.drawn = talk.intake.seen
                talk.turn.set()

    async def _write(self, talk: _Conversation) -> None:
        """Send what is new whenever a scene is drawn, so that each refresh of a screen has one."""
        loop = asyncio.get_running_loop()
        while True:
            due_s = loop.time() + _LEAST_S
            frames: list[Frame] = [*talk.outbox]
            talk.outbox.clear()
            if talk.intake.under_way < _AHEAD:
                frames += self._audience.frames(talk.visitor)
            for frame in frames:
                await asyncio.wait_for(talk.socket.send_text(self._numbered(talk, frame)), _SLOW_S)
            with contextlib.suppress(TimeoutError):
                await asyncio.wait_for(talk.turn.wait(), _PATIENCE_S)
            await asyncio.sleep(due_s - loop.time())
            talk.turn.clear()

    def _numbered(self, talk: _Conversation, frame: Frame) -> str:
        """Return a frame as text; scenes are counted, which dates what is said in answer."""
        if frame["kind"] == "scene":
            frame = {**frame, "seq": talk.intake.note_sent(self._clock.now_s())}
        return to_json(frame).decode()


@dataclass(slots=True)
class _Conversation:
    """What is said on one socket.

    Attributes:
        drawn: The last scene that is known to be drawn.
        turn: Set when the page has drawn one, or says something while it waits for none.
    """

    socket: WebSocket
    visitor: int
    intake: Intake
    drawn: int = 0
    outbox: list[Frame] = field(default_factory=list[Frame])
    turn: asyncio.Event = field(default_factory=asyncio.Event)

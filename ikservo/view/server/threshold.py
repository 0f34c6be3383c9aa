"""Connections that are no visitors yet: a few at a time, and none that does not say what it wants.

A socket that only stands there costs little, but whoever opens thousands of them, or says a byte a
second, must neither keep people out nor take time from the arm.
"""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Any, TypeGuard

from uvicorn.protocols.http.h11_impl import H11Protocol

if TYPE_CHECKING:
    from uvicorn import Config
    from uvicorn.server import ServerState

__all__ = ["MOST_WAITING", "Threshold"]

MOST_WAITING = 24
"""A page needs six for its files; when there are more, the eldest goes."""

_ASK_S = 3.0


class Threshold(H11Protocol):
    """Speaks HTTP, and websocket to whoever asks; drops who waits too long, or in a crowd."""

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self._since_s = self.loop.time()
        self._hurry: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Count a connection in; the eldest of too many is dropped."""
        super().connection_made(transport)
        self._hurry = self.loop.call_later(_ASK_S, self._drop_who_asked_nothing)
        waiting = [other for other in self.connections if _waits(other)]
        if len(waiting) > MOST_WAITING:
            min(waiting, key=_since_s).transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget a connection."""
        if self._hurry is not None:
            self._hurry.cancel()
        super().connection_lost(exc)

    def _drop_who_asked_nothing(self) -> None:
        # The types say that there is always a cycle; there is none before the first request.
        if self in self.connections and not self.cycle:
            self.transport.abort()


def _waits(connection: object) -> TypeGuard[Threshold]:
    return isinstance(connection, Threshold) and not connection.transport.is_closing()


def _since_s(connection: Threshold) -> float:
    return connection._since_s  # pyright: ignore[reportPrivateUsage]

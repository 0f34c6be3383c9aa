"""Authentication: session tokens, challenge and response, origin check, connection limit.

A socket that only stands there costs little, but whoever opens thousands of them, or says a byte a
second, must neither keep people out nor take time from the arm.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import secrets
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, TypeGuard, cast

from uvicorn.protocols.http.h11_impl import H11Protocol

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send
    from uvicorn import Config
    from uvicorn.server import ServerState

__all__ = [
    "MAX_PENDING_CONNECTIONS",
    "AccessTokens",
    "ConnectionLimiter",
    "OriginCheckMiddleware",
    "Permission",
    "challenge_response",
    "is_allowed_origin",
    "new_nonce",
]


_KEY_BYTES = 24  # 192 bits
_SINGLE_HEADERS = frozenset(
    {"host", "origin", "sec-fetch-site", "sec-fetch-mode", "sec-fetch-dest"}
)
_NAMES_OF_LOOPBACK = ("localhost", "127.0.0.1", "[::1]")


class Permission(StrEnum):
    """What a visitor may do."""

    CONTROL = "control"
    WATCH = "watch"


@dataclass(frozen=True, slots=True)
class AccessTokens:
    """The two secrets of one session; neither ever travels over the wire.

    Attributes:
        control: Lets its holder move the arm.
        watch: Lets its holder look.
    """

    control: str
    watch: str

    @classmethod
    def generate(cls) -> AccessTokens:
        """Return keys that nobody can guess."""
        return cls(secrets.token_urlsafe(_KEY_BYTES), secrets.token_urlsafe(_KEY_BYTES))

    def authorise(self, nonce: str, shown: str) -> Permission | None:
        """Return the right that a proof for a nonce gives; the comparison takes constant time.

        A nonce is asked once, so that a proof which somebody overheard opens nothing.
        """
        granted: Permission | None = None
        for right, key in ((Permission.WATCH, self.watch), (Permission.CONTROL, self.control)):
            if hmac.compare_digest(challenge_response(key, nonce).encode(), shown.encode()):
                granted = right
        return granted


def new_nonce() -> str:
    """Return a question that was never asked before."""
    return secrets.token_hex(16)


def challenge_response(key: str, nonce: str) -> str:
    """Return what shows that one knows a key without telling it: HMAC-SHA256, in hex (RFC 2104)."""
    return hmac.new(key.encode(), nonce.encode(), "sha256").hexdigest()


def is_allowed_origin(
    headers: Iterable[tuple[bytes, bytes]], local: tuple[str, int], *, upgrade: bool
) -> bool:
    """Return whether a request comes from our own page, or from a person who opens it.

    A name that somebody lets point here (DNS rebinding) is no address of this machine, and a page
    of another site has another origin.

    Args:
        headers: The request's.
        local: The address and port at which the connection arrived.
        upgrade: Whether it asks for a websocket; those always carry an origin.
    """
    found = _single_headers(headers)
    if found is None or found.get("host", "").lower() not in _own_names(*local):
        return False
    origin = found.get("origin")
    if origin is None:
        own = found.get("sec-fetch-site", "none") in ("none", "same-origin")
        opened = (
            found.get("sec-fetch-mode") == "navigate" and found.get("sec-fetch-dest") == "document"
        )
        return not upgrade and (own or opened)
    return origin == f"http://{found['host'].lower()}"


def _single_headers(headers: Iterable[tuple[bytes, bytes]]) -> Mapping[str, str] | None:
    """Return the headers that count, or None where one comes twice."""
    found: dict[str, str] = {}
    for name, value in headers:
        key = name.decode("latin-1").lower()
        if key in _SINGLE_HEADERS:
            if key in found:
                return None
            found[key] = value.decode("latin-1")
    return found


def _own_names(address: str, port: int) -> frozenset[str]:
    """Return what a browser may call the address at which a connection arrived."""
    ip = ipaddress.ip_address(address.partition("%")[0])
    names = _NAMES_OF_LOOPBACK if ip.is_loopback else (f"[{ip}]" if ip.version == 6 else str(ip),)
    usual = names if port == 80 else ()  # a browser leaves the usual port out
    return frozenset((*(f"{name}:{port}" for name in names), *usual))


_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self'; img-src 'self'; connect-src 'self'; "
    "base-uri 'none'; form-action 'none'; frame-ancestors 'none'"
)
_SECURITY_HEADERS = [
    (b"content-security-policy", _POLICY.encode()),
    (b"x-content-type-options", b"nosniff"),
    (b"x-frame-options", b"DENY"),
    (b"referrer-policy", b"no-referrer"),
    (b"cross-origin-opener-policy", b"same-origin"),
    (b"cross-origin-resource-policy", b"same-origin"),
    (b"cache-control", b"no-store"),
]
_FORBIDDEN_TEXT = b"This address is not for other pages.\n"


class OriginCheckMiddleware:
    """Refuses requests and upgrades that do not come from our own page (ASGI middleware)."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Let a request through with our headers, or answer 403."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = cast("Iterable[tuple[bytes, bytes]]", scope["headers"])
        upgrade = scope["type"] == "websocket"
        if not is_allowed_origin(headers, tuple(scope["server"]), upgrade=upgrade):
            await (
                send({"type": "websocket.close"}) if upgrade else _send_forbidden(send)
            )  # 403, both
            return

        async def send_strictly(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message["headers"], *_SECURITY_HEADERS]
            await send(message)

        await self._app(scope, receive, send_strictly)


async def _send_forbidden(send: Send) -> None:
    headers = [(b"content-type", b"text/plain"), *_SECURITY_HEADERS]
    await send({"type": "http.response.start", "status": 403, "headers": headers})
    await send({"type": "http.response.body", "body": _FORBIDDEN_TEXT})


MAX_PENDING_CONNECTIONS = 24
"""A page needs six for its files; when there are more, the eldest goes."""

_REQUEST_TIMEOUT_S = 3.0


class ConnectionLimiter(H11Protocol):
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
        self._hurry = self.loop.call_later(_REQUEST_TIMEOUT_S, self._drop_idle_connection)
        waiting = [other for other in self.connections if _is_pending(other)]
        if len(waiting) > MAX_PENDING_CONNECTIONS:
            min(waiting, key=_connected_since_s).transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Forget a connection."""
        if self._hurry is not None:
            self._hurry.cancel()
        super().connection_lost(exc)

    def _drop_idle_connection(self) -> None:
        # The types say that there is always a cycle; there is none before the first request.
        if self in self.connections and not self.cycle:
            self.transport.abort()


def _is_pending(connection: object) -> TypeGuard[ConnectionLimiter]:
    return isinstance(connection, ConnectionLimiter) and not connection.transport.is_closing()


def _connected_since_s(connection: ConnectionLimiter) -> float:
    return connection._since_s  # pyright: ignore[reportPrivateUsage]

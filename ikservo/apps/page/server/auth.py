"""Authentication: session tokens, challenge and response, origin check, connection limit.

An idle socket costs little, but a client that opens thousands of sockets, or sends a byte per
second, must neither lock other clients out nor take time from the arm.
"""

from __future__ import annotations

import asyncio
import hmac
import ipaddress
import secrets
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, cast

from uvicorn.protocols.http.h11_impl import H11Protocol

if TYPE_CHECKING:
    from starlette.types import ASGIApp, Message, Receive, Scope, Send
    from uvicorn import Config
    from uvicorn.server import ServerState

_KEY_BYTES = 24  # 192 bits
_SINGLE_HEADERS = frozenset(
    {"host", "origin", "sec-fetch-site", "sec-fetch-mode", "sec-fetch-dest"}
)
_LOOPBACK_HOSTS = ("localhost", "127.0.0.1", "[::1]")


class Permission(StrEnum):
    """Permission of a client."""

    CONTROL = "control"
    WATCH = "watch"


@dataclass(frozen=True, slots=True)
class AccessTokens:
    """The two secrets of one session, to move or to watch; neither is sent over the network."""

    control: str
    watch: str

    @classmethod
    def generate(cls) -> AccessTokens:
        """Make unguessable keys."""
        return cls(secrets.token_urlsafe(_KEY_BYTES), secrets.token_urlsafe(_KEY_BYTES))

    def authorise(self, nonce: str, proof: str) -> Permission | None:
        """Return the permission that a proof for a nonce grants; compares in constant time.

        A nonce is used once, so an intercepted proof is worthless.
        """
        granted: Permission | None = None
        for permission, key in ((Permission.WATCH, self.watch), (Permission.CONTROL, self.control)):
            if hmac.compare_digest(challenge_response(key, nonce).encode(), proof.encode()):
                granted = permission
        return granted


def new_nonce() -> str:
    """Make a nonce that has not been used before."""
    return secrets.token_hex(16)


def challenge_response(key: str, nonce: str) -> str:
    """Return the proof of knowing a key: HMAC-SHA256 of the nonce, in hex (RFC 2104)."""
    return hmac.new(key.encode(), nonce.encode(), "sha256").hexdigest()


def is_allowed_origin(
    headers: Iterable[tuple[bytes, bytes]],
    local: tuple[str, int],
    *,
    upgrade: bool,
    secure: bool = False,
) -> bool:
    """Check whether a request comes from this server's page, or from a user who opens the page.

    A foreign host name that resolves to this machine (DNS rebinding) is not this server's address,
    and a page of another site has another origin. Requests for a websocket (``upgrade``) always
    carry an origin.
    """
    unique = _single_headers(headers)
    if unique is None:
        return False
    address, port = local
    ip = ipaddress.ip_address(address.partition("%")[0])
    names = _LOOPBACK_HOSTS if ip.is_loopback else (f"[{ip}]" if ip.version == 6 else str(ip),)
    hosts = [f"{name}:{port}" for name in names]
    if port == (443 if secure else 80):  # browsers omit the default port
        hosts += names
    if unique.get("host", "").lower() not in hosts:
        return False
    origin = unique.get("origin")
    if origin is None:
        own = unique.get("sec-fetch-site", "none") in ("none", "same-origin")
        opened = (
            unique.get("sec-fetch-mode") == "navigate"
            and unique.get("sec-fetch-dest") == "document"
        )
        return not upgrade and (own or opened)
    return origin == f"{'https' if secure else 'http'}://{unique['host'].lower()}"


def _single_headers(headers: Iterable[tuple[bytes, bytes]]) -> Mapping[str, str] | None:
    """Return the security-relevant headers, or None if one occurs twice."""
    unique: dict[str, str] = {}
    for name, value in headers:
        key = name.decode("latin-1").lower()
        if key in _SINGLE_HEADERS:
            if key in unique:
                return None
            unique[key] = value.decode("latin-1")
    return unique


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
_FORBIDDEN_TEXT = b"This address does not accept requests from other pages.\n"


class OriginCheckMiddleware:
    """Filter of requests and upgrades that are not from this server's page (ASGI middleware)."""

    def __init__(self, app: ASGIApp) -> None:
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Pass a request on and add the security headers, or respond with 403."""
        if scope["type"] not in ("http", "websocket"):
            await self._app(scope, receive, send)
            return
        headers = cast("Iterable[tuple[bytes, bytes]]", scope["headers"])
        upgrade = scope["type"] == "websocket"
        secure = scope["scheme"] in ("https", "wss")
        local = tuple(scope["server"])
        if not is_allowed_origin(headers, local, upgrade=upgrade, secure=secure):
            if upgrade:  # the server answers this with 403, too
                await send({"type": "websocket.close"})
                return
            sent = [(b"content-type", b"text/plain"), *_SECURITY_HEADERS]
            await send({"type": "http.response.start", "status": 403, "headers": sent})
            await send({"type": "http.response.body", "body": _FORBIDDEN_TEXT})
            return

        async def send_strictly(message: Message) -> None:
            if message["type"] == "http.response.start":
                message["headers"] = [*message["headers"], *_SECURITY_HEADERS]
            await send(message)

        await self._app(scope, receive, send_strictly)


MAX_PENDING_CONNECTIONS = 24
"""Limit on pending connections; a page needs six for its files. The oldest is dropped."""

REQUEST_TIMEOUT_S = 3.0
"""Longest time [s] for a TLS handshake, and from there to the end of the first request."""


class ConnectionLimiter(H11Protocol):
    """HTTP protocol that drops idle connections, and the oldest if too many are pending."""

    def __init__(
        self,
        config: Config,
        server_state: ServerState,
        app_state: dict[str, Any],
        _loop: asyncio.AbstractEventLoop | None = None,
    ) -> None:
        super().__init__(config, server_state, app_state, _loop)
        self._since_s = self.loop.time()
        self._idle_timer: asyncio.TimerHandle | None = None

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Register a connection; drop the oldest if there are too many."""
        super().connection_made(transport)
        self._idle_timer = self.loop.call_later(REQUEST_TIMEOUT_S, self._drop_idle_connection)
        waiting = [
            other
            for other in self.connections
            if isinstance(other, ConnectionLimiter) and not other.transport.is_closing()
        ]
        if len(waiting) > MAX_PENDING_CONNECTIONS:
            min(waiting, key=lambda each: each._since_s).transport.abort()

    def connection_lost(self, exc: Exception | None) -> None:
        """Cancel the idle timer."""
        if self._idle_timer is not None:
            self._idle_timer.cancel()
        super().connection_lost(exc)

    def _drop_idle_connection(self) -> None:
        # Despite the type hints, the cycle is None before the first request.
        if self in self.connections and not self.cycle:
            self.transport.abort()

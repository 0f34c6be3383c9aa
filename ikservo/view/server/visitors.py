"""Who may come in: the addresses a page may have, and the keys that prove a visitor's right."""

from __future__ import annotations

import hmac
import ipaddress
import secrets
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import StrEnum

__all__ = ["Keys", "Right", "door_opens", "new_nonce", "proof"]

_KEY_BYTES = 24  # 192 bits
_COUNT = frozenset({"host", "origin", "sec-fetch-site", "sec-fetch-mode", "sec-fetch-dest"})
_NAMES_OF_LOOPBACK = ("localhost", "127.0.0.1", "[::1]")


class Right(StrEnum):
    """What a visitor may do."""

    CONTROL = "control"
    WATCH = "watch"


@dataclass(frozen=True, slots=True)
class Keys:
    """The two secrets of one session; neither ever travels over the wire.

    Attributes:
        control: Lets its holder move the arm.
        watch: Lets its holder look.
    """

    control: str
    watch: str

    @classmethod
    def new(cls) -> Keys:
        """Return keys that nobody can guess."""
        return cls(secrets.token_urlsafe(_KEY_BYTES), secrets.token_urlsafe(_KEY_BYTES))

    def right(self, nonce: str, shown: str) -> Right | None:
        """Return the right that a proof for a nonce gives; the comparison takes constant time.

        A nonce is asked once, so that a proof which somebody overheard opens nothing.
        """
        granted: Right | None = None
        for right, key in ((Right.WATCH, self.watch), (Right.CONTROL, self.control)):
            if hmac.compare_digest(proof(key, nonce).encode(), shown.encode()):
                granted = right
        return granted


def new_nonce() -> str:
    """Return a question that was never asked before."""
    return secrets.token_hex(16)


def proof(key: str, nonce: str) -> str:
    """Return what shows that one knows a key without telling it: HMAC-SHA256, in hex (RFC 2104)."""
    return hmac.new(key.encode(), nonce.encode(), "sha256").hexdigest()


def door_opens(
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
    found = _single(headers)
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


def _single(headers: Iterable[tuple[bytes, bytes]]) -> Mapping[str, str] | None:
    """Return the headers that count, or None where one comes twice."""
    found: dict[str, str] = {}
    for name, value in headers:
        key = name.decode("latin-1").lower()
        if key in _COUNT:
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

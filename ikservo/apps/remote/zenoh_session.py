"""Zenoh sessions with explicit endpoints, TLS and access control."""

from __future__ import annotations

import contextlib
import getpass
import json
import platform
import socket
import ssl
from collections.abc import Callable, Generator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import AbstractContextManager, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal, TypeVar

from ikservo.apps.remote import key_expressions as keys
from ikservo.apps.remote.address import Endpoint
from ikservo.errors import IkservoError, PortError
from ikservo.remedies import install_command

if TYPE_CHECKING:
    import zenoh

LINK_LEASE_S = 1.0
"""Time after which a link is closed if nothing arrives from the other end."""

_CONNECT_TIMEOUT_S = 2.0

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Certificate:
    """Files: this end's certificate and private key, and the authority that both ends trust."""

    authority: Path
    certificate: Path
    key: Path


def open_server(
    listen: Endpoint, certificate: Certificate | None, access: Mapping[str, object] | None
) -> AbstractContextManager[zenoh.Session]:
    """Listen at an endpoint in the ``with`` block; TLS needs a certificate and access control.

    Raises:
        PortError: The endpoint is in use, or the certificate cannot be used.
        IkservoError: The extra ``net`` is not installed.
    """
    config = _common_settings() | {"listen/endpoints": [str(listen)]}
    if access is not None:
        config["access_control"] = access
    if certificate is not None:
        config["transport/link/tls"] = _tls_settings(certificate, "listen")
    return _opened(config, f"Cannot listen at {listen}", "Choose another endpoint.")


def open_client(
    connect: Sequence[Endpoint], certificate: Certificate | None
) -> AbstractContextManager[zenoh.Session]:
    """Connect to an endpoint; the session is closed at the end of the block.

    Raises:
        PortError: Nothing listens there, or the other end refuses the certificate.
        IkservoError: The extra ``net`` is not installed.
    """
    config = _client_settings(connect, certificate)
    hint = "Is `ikservo serve` running there, and reachable? Were both certificates made together?"
    place = ", ".join(map(str, connect))
    return _opened(config, f"No arm can be reached at {place}", hint)


def open_router_client(
    router: Endpoint, certificate: Certificate | None
) -> AbstractContextManager[zenoh.Session]:
    """Connect to the Zenoh router of ROS 2; the session is closed at the end of the block.

    Raises:
        PortError: Nothing listens there, or the other end refuses the certificate.
        IkservoError: The extra ``net`` is not installed.
    """
    config = _client_settings([router], certificate)
    config |= {"mode": "client", "timestamping/enabled": True}  # a publisher's cache needs it
    hint = "Start it: ros2 run rmw_zenoh_cpp rmw_zenohd. Elsewhere: --router tcp/HOST:7447"
    return _opened(config, f"No ROS 2 Zenoh router found at {router}", hint)


def _client_settings(
    connect: Sequence[Endpoint], certificate: Certificate | None
) -> dict[str, object]:
    config = _common_settings() | {
        "listen/endpoints": [],
        "connect/endpoints": [str(endpoint) for endpoint in connect],
        "connect/timeout_ms": int(1000 * _CONNECT_TIMEOUT_S),
        "connect/exit_on_failure": True,
    }
    if certificate is not None:
        tls = _tls_settings(certificate, "connect")
        config["transport/link/tls"] = {**tls, "verify_name_on_connect": True}
    return config


def _tls_settings(certificate: Certificate, end: Literal["listen", "connect"]) -> dict[str, object]:
    return {
        "root_ca_certificate": str(certificate.authority),
        f"{end}_certificate": str(certificate.certificate),
        f"{end}_private_key": str(certificate.key),
        "enable_mtls": True,
        "close_link_on_expiration": True,
    }


def ask(
    session: zenoh.Session, key: str, payload: bytes, timeout_s: float
) -> list[tuple[str, bytes]]:
    """Send a request; return the key and payload of each answer that arrives in time."""
    answers = (reply.ok for reply in session.get(key, payload=payload, timeout=timeout_s))
    return [(str(ok.key_expr), ok.payload.to_bytes()) for ok in answers if ok is not None]


def on_each_host(hosts: list[Endpoint], do: Callable[[Endpoint], T]) -> list[T | IkservoError]:
    """Call a function for every machine in parallel; return the results or errors."""

    def attempt(host: Endpoint) -> T | IkservoError:
        try:
            return do(host)
        except IkservoError as error:
            return error

    if not hosts:
        return []
    with ThreadPoolExecutor(min(32, len(hosts))) as pool:
        return list(pool.map(attempt, hosts))


def served_names(session: zenoh.Session, timeout_s: float) -> list[str]:
    """Return the names under which the other end of a session serves arms."""
    replies = session.liveliness().get(keys.server("*"), timeout=timeout_s)
    return sorted(str(each.ok.key_expr).split("/")[1] for each in replies if each.ok is not None)


def who_asks() -> str:
    """Return the user and machine of this program, as shown to other users."""
    try:
        user = getpass.getuser()
    except (ImportError, KeyError, OSError):  # an account without a name
        user = "somebody"
    return f"{user} on {platform.node()}"


def _common_settings() -> dict[str, object]:
    """Return the settings for both ends, with discovery switched off."""
    return {
        "mode": "peer",
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        "adminspace/enabled": False,
        "transport/link/tx/lease": int(1000 * LINK_LEASE_S),
        "transport/link/tx/keep_alive": 4,
        "transport/link/rx/max_message_size": 4 * 1024 * 1024,
    }


@contextmanager
def _opened(settings: Mapping[str, object], what: str, hint: str) -> Generator[zenoh.Session]:
    try:
        import zenoh  # noqa: PLC0415  # an extra
    except ImportError:
        raise IkservoError(
            "Arms on other machines need the package eclipse-zenoh, which is not installed.",
            f"Install it: {install_command('net')}",
        ) from None
    config = zenoh.Config()
    try:
        for key, value in settings.items():
            config.insert_json5(key, json.dumps(value))  # pyright: ignore[reportUnknownMemberType]
        session = zenoh.open(config)
    except zenoh.ZError as error:
        # Zenoh's message is used without its source locations.
        reason = str(error).partition(" at /")[0].strip().rstrip(".!")
        if "Timeout" in reason:
            reason = "it does not answer"
        elif "in use" in reason:
            reason = "the address is in use"
        why, remedy = _why_unreachable(settings) or (reason, hint)
        raise PortError(f"{what}: {why}.", remedy or hint) from None
    try:
        yield session
    finally:
        with contextlib.suppress(zenoh.ZError):  # the link may be gone
            session.close()  # pyright: ignore[reportUnknownMemberType]


def _why_unreachable(settings: Mapping[str, object]) -> tuple[str, str] | None:
    """Return the reason why the only endpoint is unreachable, with a hint; None if unknown.

    Zenoh reports the same timeout for a missing host, a closed port, and TLS at only one end.
    """
    match settings.get("connect/endpoints"):
        case [str(place)]:
            protocol, _, address = place.partition("/")
        case _:
            return None
    host, _, port = address.rpartition(":")
    host = host.strip("[]")
    try:
        with socket.create_connection((host, int(port)), _CONNECT_TIMEOUT_S) as connection:
            speaks_tls = _answers_tls(connection)
    except socket.gaierror:
        return f"there is no machine named {host}", "Check its name, or give its IP address."
    except ConnectionRefusedError:
        return "nothing listens there", ""
    except OSError:
        return None
    if protocol == "tls" and not speaks_tls:
        return "arms are served there without TLS", f"Write tcp/ before the host: tcp/{host}"
    if protocol == "tcp" and speaks_tls:
        return "arms are served there with TLS", f"Write tls/ before the host: tls/{host}"
    return None


def _answers_tls(connection: socket.socket) -> bool:
    """Check whether the other end answers a TLS greeting; nothing is verified or sent."""
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    context.check_hostname, context.verify_mode = False, ssl.CERT_NONE
    connection.settimeout(_CONNECT_TIMEOUT_S)
    try:
        context.wrap_socket(connection).close()
    except ssl.SSLError as error:
        return "ALERT" in str(error).upper()  # the other end requires a certificate, so it uses TLS
    except OSError:  # the other end is silent, or closes at once
        return False
    return True

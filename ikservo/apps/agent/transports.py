"""The transports of the protocol: standard input and output, or HTTPS with a key."""

from __future__ import annotations

import hmac
import ipaddress
import secrets
import signal
import socket
import sys
from typing import Any

import anyio
import uvicorn
from mcp.server import MCPServer
from mcp.server.transport_security import TransportSecuritySettings
from starlette.responses import Response
from starlette.types import ASGIApp, Receive, Scope, Send

from ikservo.app_discovery import find_part
from ikservo.apps.agent.agent_arm import AgentArm
from ikservo.apps.agent.allowance import Consent
from ikservo.apps.agent.consent_server import consent_server
from ikservo.apps.agent.mcp_server import make_server
from ikservo.cli.terminal import print_status
from ikservo.errors import BadValueError, PortError


def serve_agent(agent: AgentArm, http_port: int | None, listen: str) -> None:
    """Serve an arm until the agent disconnects, or until Ctrl-C.

    Raises:
        BadValueError: The address is not an IP address.
        PortError: The port is in use.
        FileWriteError: The address of the consent page cannot be stored.
    """
    with consent_server(agent) as address:
        if agent.allowance.consent in (Consent.ASK, Consent.SLOW):
            print_status(f"Approve the agent's plans here: {address}")
            print_status("or in another terminal: ikservo mcp --approve")
        server = make_server(agent)
        if http_port is None:
            if sys.stdin.isatty():
                print_status("Waiting for an agent on standard input. Ctrl-C ends this.")
            # At Ctrl-C, asyncio would cancel its tasks and wait for the one that reads a line.
            before = signal.signal(signal.SIGINT, signal.getsignal(signal.SIGTERM))
            try:
                anyio.run(server.run_stdio_async)
            finally:
                signal.signal(signal.SIGINT, before)
        else:
            _serve_https(server, listen, http_port)


def _serve_https(server: MCPServer[Any], listen: str, port: int) -> None:
    try:
        address = ipaddress.ip_address(listen)
    except ValueError:
        raise BadValueError("--listen", listen, "an IP address, such as 127.0.0.1") from None
    if address.is_unspecified:
        raise BadValueError("--listen", listen, "the address at which clients reach this machine")
    certificate = find_part("certificate")(listen)
    family = socket.AF_INET6 if address.version == 6 else socket.AF_INET
    try:
        listening = socket.create_server((listen, port), family=family)
    except OSError as error:
        raise PortError(f"Cannot open TCP port {port} at {listen}: {error.strerror}.") from None
    port = listening.getsockname()[1]
    key = secrets.token_urlsafe(24)
    shown = f"[{listen}]" if address.version == 6 else listen
    names = [f"{shown}:{port}", *([f"localhost:{port}"] if address.is_loopback else [])]
    security = TransportSecuritySettings(
        allowed_hosts=names, allowed_origins=[f"https://{name}" for name in names]
    )
    app = _require_key(server.streamable_http_app(transport_security=security), key)
    print_status(f"Address: https://{names[0]}/mcp")
    print_status(f"Header:  Authorization: Bearer {key}")
    print_status(f"SHA-256 of the certificate: {certificate.fingerprint}")
    config = uvicorn.Config(
        app,
        log_config=None,
        access_log=False,
        ssl_certfile=str(certificate.path),
        ssl_keyfile=str(certificate.path),
        log_level="critical",
        ws="none",
        timeout_graceful_shutdown=0,  # Ctrl-C ends the calls, so that the arm brakes
    )
    uvicorn.Server(config).run([listening])


def _require_key(app: ASGIApp, key: str) -> ASGIApp:
    """Return an application that answers 401 to requests without the key before reading them."""
    expected = f"Bearer {key}".encode()

    async def answer(scope: Scope, receive: Receive, send: Send) -> None:
        given = dict(scope.get("headers", ())).get(b"authorization", b"")
        if scope["type"] == "http" and not hmac.compare_digest(given, expected):
            refusal = Response("The key is wrong.\n", 401, {"www-authenticate": "Bearer"})
            await refusal(scope, receive, send)
        else:
            await app(scope, receive, send)

    return answer

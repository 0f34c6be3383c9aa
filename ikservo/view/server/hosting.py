"""An address on this machine, and the server that listens there until it is told to end."""

from __future__ import annotations

import contextlib
import errno
import socket
import threading
from collections.abc import Generator
from contextlib import contextmanager

import uvicorn
from starlette.applications import Starlette

from ikservo.errors import PortError
from ikservo.view.server.messages import LONGEST_BYTES
from ikservo.view.server.threshold import Threshold

__all__ = ["Address", "hosted", "serve"]

_BYTES_A_CHARACTER = 4


class Address:
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


def serve(app: Starlette, address: Address) -> None:
    """Serve until SIGINT or SIGTERM; the caller's thread is the main one."""
    with contextlib.suppress(KeyboardInterrupt):
        _server(app).run(sockets=[address.socket])


@contextmanager
def hosted(app: Starlette, address: Address) -> Generator[str]:
    """Serve in a thread of its own as long as the block lasts; yields the URL."""
    server = _server(app)
    thread = threading.Thread(target=server.run, args=([address.socket],), daemon=True)
    thread.start()
    try:
        yield address.url
    finally:
        server.should_exit = True
        thread.join()


def _server(app: Starlette) -> uvicorn.Server:
    config = uvicorn.Config(
        app,
        log_level="warning",
        lifespan="off",
        http=Threshold,
        ws="websockets-sansio",
        ws_max_size=LONGEST_BYTES * _BYTES_A_CHARACTER,
        ws_per_message_deflate=False,
        ws_ping_interval=5.0,
        ws_ping_timeout=5.0,
        timeout_graceful_shutdown=1,
        server_header=False,
        proxy_headers=False,
    )
    return uvicorn.Server(config)

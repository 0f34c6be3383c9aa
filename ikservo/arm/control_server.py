"""The control server of an open arm: stop, state and relax requests from other processes.

The messages are those of ``control_client``; anything else is refused.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections import deque
from collections.abc import Callable, Mapping

from ikservo.arm.result_json import encode_value
from ikservo.arm.service import ArmService
from ikservo.errors import IkservoError, RefusedError
from ikservo.guard import StopKind, StopReason
from ikservo.hardware.transport import abandon_in_forked_children
from ikservo.serving.control_client import (
    MAX_REQUEST_BYTES,
    ControlCommand,
    Request,
    decode_request,
    encode_reply,
)
from ikservo.serving.control_socket import ListeningSocket, connect, open_socket, socket_path
from ikservo.serving.replies import error_fields

RequestHandler = Callable[[Request], object]
"""Executes a request and returns the result as JSON values; called in separate threads."""

_MAX_CLIENTS = 16
_MAX_READING = 12  # clients that wait for the state of the arm; the other places are for stops
_REQUEST_TIMEOUT_S = 1.0  # a client that takes longer for its one line is disconnected


def serve(device: str, handler: RequestHandler, arm: str = "") -> ControlServer | None:
    """Listen for the clients of a device that this process has opened.

    The socket has the name of the arm if another arm on the device already listens.

    Returns:
        The server; None if no safe socket can be created. An arm also works without a server.
    """
    try:
        listening = open_socket(socket_path(device)) or open_socket(socket_path(device, arm))
    except (OSError, IkservoError):
        return None
    return ControlServer(listening, handler) if listening else None


class ControlServer:
    """Server of clients until it is closed: one thread per client, a few at a time."""

    def __init__(self, listening: ListeningSocket, handler: RequestHandler) -> None:
        self._listening, self._handler = listening, handler
        self._free = threading.BoundedSemaphore(_MAX_CLIENTS)
        self._may_read = threading.BoundedSemaphore(_MAX_READING)
        self._silent: deque[socket.socket] = deque()  # clients without a request, oldest first
        self._closing = False
        self._thread = threading.Thread(
            target=self._accept_clients, name="ikservo-owner", daemon=True
        )
        self._thread.start()
        abandon_in_forked_children(self)

    def abandon(self) -> None:
        """Close the copy of the socket in a forked child; the parent continues to listen."""
        self._closing = True
        self._listening.socket.close()

    def close(self) -> None:
        """Stop listening; wait up to a second for clients that are being served."""
        if self._closing:
            return
        self._closing = True
        with contextlib.suppress(OSError):
            found = connect(self._listening.path, 0.5)  # interrupts accept
            if found:
                found[0].close()
        self._thread.join(1.0)
        self._listening.close()
        deadline_s = time.monotonic() + _REQUEST_TIMEOUT_S
        for _ in range(_MAX_CLIENTS):
            self._free.acquire(timeout=max(0.0, deadline_s - time.monotonic()))

    def _accept_clients(self) -> None:
        while not self._closing:
            try:
                connection, _ = self._listening.socket.accept()
            except OSError:
                return
            if self._closing or not self._make_room():
                connection.close()
                continue
            self._silent.append(connection)
            threading.Thread(target=self._serve_client, args=(connection,), daemon=True).start()

    def _make_room(self) -> bool:
        """Reserve a place for a client; if all are taken, drop the oldest silent client.

        Stalled clients must not block a stop, whose client sends its line at once.
        """
        if self._free.acquire(blocking=False):
            return True
        with contextlib.suppress(IndexError, OSError):
            self._silent.popleft().shutdown(socket.SHUT_RDWR)
        return self._free.acquire(timeout=_REQUEST_TIMEOUT_S)

    def _serve_client(self, connection: socket.socket) -> None:
        try:
            with connection, contextlib.suppress(OSError):  # a client that is too slow, or gone
                try:
                    line = _receive_line(connection)
                finally:
                    with contextlib.suppress(ValueError):  # its place was taken
                        self._silent.remove(connection)
                fields = self._make_reply(connection, line)
                connection.settimeout(_REQUEST_TIMEOUT_S)
                connection.sendall(encode_reply(fields))
        finally:
            self._free.release()

    def _make_reply(self, connection: socket.socket, line: bytes) -> Mapping[str, object]:
        try:
            request = decode_request(line)
            if not self._listening.authenticate(connection, request.secret):
                raise RefusedError("The arm belongs to another user.", "Nothing was done.")
            if request.do is not ControlCommand.WHERE:
                return {"result": self._handler(request)}
            if not self._may_read.acquire(blocking=False):
                raise RefusedError(
                    "Too many programs are asking for the state of this arm.", "Try again."
                )
            try:
                return {"result": self._handler(request)}
            finally:
                self._may_read.release()
        except Exception as error:  # a client must not end this program
            return {"error": error_fields(error)}


def _receive_line(connection: socket.socket) -> bytes:
    """Receive the first line, or the part of it that arrived in time."""
    deadline_s, line = time.monotonic() + _REQUEST_TIMEOUT_S, b""
    while not line.endswith(b"\n") and len(line) <= MAX_REQUEST_BYTES:
        connection.settimeout(max(1e-3, deadline_s - time.monotonic()))
        piece = connection.recv(MAX_REQUEST_BYTES + 1 - len(line))
        if not piece:
            break
        line += piece
        if time.monotonic() > deadline_s:
            raise TimeoutError
    return line


_STOPPED = StopReason(StopKind.CLIENT, "Stopped from another terminal; torque stays on.")
_STOPPED_AT_REST = StopReason(StopKind.CLIENT, "Stopped from another terminal.")
_RELAXED = StopReason(StopKind.RELEASED, "Torque switched off from another terminal.")


def command_handler(service: ArmService) -> RequestHandler:
    """Return a function that executes other processes' commands on an arm."""

    def handle(request: Request) -> object:
        match request.do:
            case ControlCommand.STOP:
                return encode_value(service.stop(_STOPPED, _STOPPED_AT_REST))
            case ControlCommand.WHERE:
                return encode_value(service.arm.where())
            case ControlCommand.RELAX:
                return encode_value(service.relax(_STOPPED, _RELAXED))
            case ControlCommand.WHO:
                return {"arm": service.arm.model.name, "port": service.arm.port_name}

    return handle

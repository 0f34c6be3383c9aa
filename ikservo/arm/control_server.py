"""The control server of an open arm: stop, state and relax requests from other processes.

A request has no pickle, no code and no file name: one command of a fixed list, and a secret where
the socket has no permissions. Anything else is refused.
"""

from __future__ import annotations

import contextlib
import json
import socket
import threading
import time
from collections.abc import Callable, Generator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from enum import StrEnum
from pathlib import Path
from threading import RLock
from typing import Any, Protocol, cast

from ikservo.arm.control_socket import (
    ListeningSocket,
    connect,
    open_socket,
    socket_path,
    socket_paths,
)
from ikservo.arm.reports import ArmState, JointMoveResult
from ikservo.control.stopping import StopOutcome
from ikservo.errors import ExitCode, IkservoError, InputError, RefusedError
from ikservo.files.reading import parse_json
from ikservo.guard import StopKind, StopReason
from ikservo.hardware.transport import abandon_in_forked_children

__all__ = [
    "BRAKE_TIMEOUT_S",
    "MAX_REPLY_BYTES",
    "MAX_REQUEST_BYTES",
    "Command",
    "CommandHandler",
    "ControlServer",
    "RemoteTarget",
    "Request",
    "RequestHandler",
    "broadcast_command",
    "decode_reply",
    "decode_request",
    "encode_reply",
    "encode_request",
    "send_command",
    "serve",
]


SCHEMA = "ikservo/owner/1"
MAX_REQUEST_BYTES = 512  # bytes, the end of the line included
MAX_REPLY_BYTES = 65_536
_KEYS = {"schema", "do", "secret"}


class Command(StrEnum):
    """The commands of other processes."""

    STOP = "stop"
    WHERE = "where"
    RELAX = "relax"


@dataclass(frozen=True, slots=True)
class Request:
    """A request of another process.

    Attributes:
        do: The command.
        secret: Proves that it is the same user, where the socket has no permissions.
    """

    do: Command
    secret: str = ""


def encode_request(request: Request) -> bytes:
    """Encode a request as one line."""
    return _encode_line({"schema": SCHEMA, "do": request.do.value, "secret": request.secret})


def decode_request(line: bytes) -> Request:
    """Decode the request in a line.

    Raises:
        InputError: It is too long, no JSON, or anything but a request of this schema.
    """
    row = _decode_line(line, MAX_REQUEST_BYTES)
    if row.keys() != _KEYS or row["schema"] != SCHEMA:
        raise _message_error(f"expected the keys {', '.join(sorted(_KEYS))} of {SCHEMA}")
    if row["do"] not in list(Command) or not isinstance(row["secret"], str):
        raise _message_error(f"it can be asked to {', '.join(Command)}")
    return Request(Command(row["do"]), row["secret"])


def encode_reply(fields: Mapping[str, object]) -> bytes:
    """Encode a reply as one line."""
    return _encode_line({"schema": SCHEMA, **fields})


def decode_reply(line: bytes) -> dict[str, Any]:
    """Decode the fields of a reply.

    Raises:
        InputError: It is none of this schema.
    """
    row = _decode_line(line, MAX_REPLY_BYTES)
    if row.pop("schema", None) != SCHEMA:
        raise _message_error(f"expected an answer of {SCHEMA}")
    return row


def _encode_line(row: Mapping[str, object]) -> bytes:
    return json.dumps(row, allow_nan=False, separators=(",", ":")).encode() + b"\n"


def _decode_line(line: bytes, max_bytes: int) -> dict[str, Any]:
    if len(line) > max_bytes:
        raise _message_error(f"at most {max_bytes} bytes")
    if not line.endswith(b"\n"):
        raise _message_error("the end of the line is missing")
    try:
        row = parse_json(line)
    except (ValueError, RecursionError):  # not UTF-8, no JSON, a number too long, nested too deep
        raise _message_error("expected one line of JSON") from None
    if not isinstance(row, dict):
        raise _message_error("expected an object")
    return cast("dict[str, Any]", row)


def _message_error(why: str) -> InputError:
    return InputError(f"Not a valid message between ikservo programs: {why}.", "Nothing was done.")


RequestHandler = Callable[[Request], Mapping[str, object]]
"""Executes a request and returns the fields of the reply; called in threads of its own."""

_MAX_CLIENTS = 16
_REQUEST_TIMEOUT_S = 1.0  # a client that takes longer for its one line is disconnected


def serve(device: str, handler: RequestHandler, arm: str = "") -> ControlServer | None:
    """Listen for the clients of a device that this process has opened.

    Args:
        device: The port.
        handler: Executes requests.
        arm: The arm's name; it listens there where another arm of the device listens already.

    Returns:
        The server, or None where no safe socket can be made: an arm works without.
    """
    try:
        listening = open_socket(socket_path(device)) or open_socket(socket_path(device, arm))
    except (OSError, IkservoError):
        return None
    return ControlServer(listening, handler) if listening else None


class ControlServer:
    """Serves clients until it is closed; each one in a thread, a few at a time.

    Args:
        listening: The socket.
        handler: Executes requests.
    """

    def __init__(self, listening: ListeningSocket, handler: RequestHandler) -> None:
        self._listening, self._handler = listening, handler
        self._free = threading.BoundedSemaphore(_MAX_CLIENTS)
        self._closing = False
        self._thread = threading.Thread(
            target=self._accept_clients, name="ikservo-owner", daemon=True
        )
        self._thread.start()
        abandon_in_forked_children(self)

    def abandon(self) -> None:
        """Close a forked child's copy of the socket: its parent continues to listen."""
        self._closing = True
        self._listening.socket.close()

    def close(self) -> None:
        """Stop listening; waits a second for clients that are being served."""
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
            if self._closing or not self._free.acquire(blocking=False):
                connection.close()
                continue
            threading.Thread(target=self._serve_client, args=(connection,), daemon=True).start()

    def _serve_client(self, connection: socket.socket) -> None:
        try:
            with connection, contextlib.suppress(OSError):  # a client that is too slow, or gone
                line = _receive_line(connection)
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
            return self._handler(request)
        except IkservoError as error:
            return _error_fields(error)
        except Exception as error:  # a client must not end this program
            return _error_fields(IkservoError(f"It failed: {type(error).__name__}: {error}."))


def _receive_line(connection: socket.socket) -> bytes:
    """Receive the first line, or the part of it that came in time."""
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


def _error_fields(error: IkservoError) -> Mapping[str, object]:
    return {"error": error.message, "hint": error.command_hint, "exit_code": int(error.exit_code)}


def send_command(
    device: str, command: Command, timeout_s: float = 10.0, arm: str = ""
) -> dict[str, Any] | None:
    """Send a command to the process that has a device open.

    Args:
        device: The port, by any of its names.
        command: The command.
        timeout_s: How long the reply may take; relaxing is slow.
        arm: The arm's name, which counts where the process has two arms at the device.

    Returns:
        The fields of the reply, or None where no process listens.

    Raises:
        IkservoError: The command failed there; carries its message and its exit code.
    """
    own = _request_at(socket_path(device, arm), device, command, timeout_s) if arm else None
    return own or _request_at(socket_path(device), device, command, timeout_s)


def broadcast_command(
    command: Command, timeout_s: float = 10.0
) -> list[dict[str, Any] | IkservoError]:
    """Send a command to every process of this user that has a device open.

    Returns:
        A reply, or an error, of each that listens.
    """

    def request(path: Path) -> dict[str, Any] | IkservoError | None:
        try:
            return _request_at(path, "a port", command, timeout_s)
        except IkservoError as error:
            return error

    with ThreadPoolExecutor() as pool:  # one without a reply must not delay the others
        replies = list(pool.map(request, socket_paths()))
    return [reply for reply in replies if reply is not None]


def _request_at(
    path: Path, device: str, command: Command, timeout_s: float
) -> dict[str, Any] | None:
    try:
        found = connect(path, timeout_s)
        if found is None:
            return None
        connection, secret = found
        with connection:
            return _check_reply(_exchange_lines(connection, Request(command, secret), timeout_s))
    except IkservoError:
        raise
    except OSError as error:
        raise IkservoError(
            f"The program that has {device} open does not answer ({error}).",
            "End it and try again.",
        ) from None


def _exchange_lines(connection: socket.socket, request: Request, timeout_s: float) -> bytes:
    deadline_s, reply = time.monotonic() + timeout_s, b""
    with contextlib.suppress(BrokenPipeError):  # disconnected at once; its reply may still be there
        connection.sendall(encode_request(request))
    while not reply.endswith(b"\n") and len(reply) <= MAX_REPLY_BYTES:
        connection.settimeout(max(1e-3, deadline_s - time.monotonic()))
        piece = connection.recv(MAX_REPLY_BYTES + 1 - len(reply))
        if not piece:
            raise ConnectionError("it has too many callers, or has just ended")
        reply += piece
    return reply


def _check_reply(reply: bytes) -> dict[str, Any]:
    fields = decode_reply(reply)
    if "error" not in fields:
        return fields
    error = IkservoError(str(fields["error"]), str(fields.get("hint", "")))
    with contextlib.suppress(ValueError):
        error.exit_code = ExitCode(int(fields.get("exit_code", 1)))
    raise error


_STOPPED = StopReason(StopKind.CLIENT, "Stopped from another terminal; torque stays on.")
_STOPPED_AT_REST = StopReason(StopKind.CLIENT, "Stopped from another terminal.")
_RELAXED = StopReason(StopKind.RELEASED, "Torque switched off from another terminal.")
BRAKE_TIMEOUT_S = 3.0


class RemoteTarget(Protocol):
    """What commands of other processes need of an arm; ``MotionRunner`` has it."""

    @property
    def arm_name(self) -> str:
        """The arm's name."""
        ...

    @property
    def port_name(self) -> str:
        """The name of its port."""
        ...

    @property
    def joint_names(self) -> tuple[str, ...]:
        """Its joints."""
        ...

    @property
    def lock(self) -> RLock:
        """Held by each motion."""
        ...

    @property
    def motion_running(self) -> bool:
        """Whether a motion runs."""
        ...

    def request_stop(self, reason: StopReason) -> None:
        """Brake the running motion and hold."""

    def stop_servos(self, reason: StopReason) -> StopOutcome:
        """Hold the measured positions, while no motion runs."""
        ...

    def latch_stop(self, reason: StopReason) -> None:
        """Refuse motions until ``acknowledge``."""

    def acknowledge(self) -> None:
        """End a stop."""

    def state(self) -> ArmState:
        """Measure the state, while no motion runs."""
        ...

    def last_state(self) -> ArmState:
        """Return the state of the last control cycle."""
        ...


class CommandHandler:
    """Handles the commands of other processes; called in threads of its own.

    A motion of the arm's own program holds the lock. A stop needs no lock; a state request is then
    answered with the last control cycle.

    Args:
        target: The arm.
        relax: Lowers it and switches torque off.
    """

    def __init__(self, target: RemoteTarget, relax: Callable[[], JointMoveResult]) -> None:
        self._target, self._relax = target, relax

    def __call__(self, request: Request) -> Mapping[str, object]:
        """Execute a command and return the fields of the reply.

        Raises:
            IkservoError: It failed.
        """
        match request.do:
            case Command.STOP:
                return self._handle_stop()
            case Command.WHERE:
                return self._handle_where()
            case Command.RELAX:
                return self._handle_relax()

    def _handle_stop(self) -> Mapping[str, object]:
        target = self._target
        moving = False
        if not target.lock.acquire(blocking=False):  # a motion, or a thread that reads servos
            target.request_stop(_STOPPED)
            moving = target.motion_running
            self._wait_for_lock(BRAKE_TIMEOUT_S)
        try:
            ended = StopOutcome(target.joint_names, (), ())  # a motion that ended holds
            outcome = ended if moving else target.stop_servos(_STOPPED_AT_REST)
        finally:
            target.lock.release()
        return {
            "arm": target.arm_name,
            "port": target.port_name,
            "moving": moving,
            **asdict(outcome),
        }

    def _handle_where(self) -> Mapping[str, object]:
        if self._target.lock.acquire(blocking=False):
            try:
                state, moving = self._target.state(), False
            finally:
                self._target.lock.release()
        else:
            state, moving = self._target.last_state(), True
        joints = [asdict(joint) for joint in state.joints]
        return {"moving": moving, "tip_m": state.tip_m.tolist(), "joints": joints}

    def _handle_relax(self) -> Mapping[str, object]:
        self._handle_stop()
        with self._acquire_lock(BRAKE_TIMEOUT_S):
            self._target.acknowledge()
            report = self._relax()
            self._target.latch_stop(_RELAXED)
        return {**asdict(report), "measured_tip_m": report.measured_tip_m.tolist()}

    @contextmanager
    def _acquire_lock(self, timeout_s: float) -> Generator[None]:
        self._wait_for_lock(timeout_s)
        try:
            yield
        finally:
            self._target.lock.release()

    def _wait_for_lock(self, timeout_s: float) -> None:
        if not self._target.lock.acquire(timeout=timeout_s):
            raise IkservoError(
                "The program that moves the arm did not stop when told to.",
                "End it, or switch off the arm's power.",
            )

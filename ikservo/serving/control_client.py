"""Commands to the control server of an open arm, and their messages.

A request contains no pickle, code or file name, only a command from a fixed list, and a secret if
the socket has no permissions.

``ikservo stop`` imports this module and nothing larger: no NumPy, pydantic or pyserial, because
importing them takes longer than braking an arm.
"""

from __future__ import annotations

import contextlib
import json
import socket
import time
from collections.abc import Iterable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from enum import StrEnum
from pathlib import Path
from typing import Any, cast

from ikservo.errors import IkservoError, InputError
from ikservo.files.reading import parse_json
from ikservo.serving.control_socket import connect, socket_path, socket_paths
from ikservo.serving.early_stops import leave_mark
from ikservo.serving.replies import other_version_error, result_in

BRAKE_TIMEOUT_S = 3.0
_WHO_TIMEOUT_S = 1.0

SCHEMA = "ikservo/owner/1"
MAX_REQUEST_BYTES = 512  # bytes, including the end of the line
MAX_REPLY_BYTES = 65_536
_KEYS = {"schema", "do", "secret"}


class ControlCommand(StrEnum):
    """The commands that other processes may send."""

    STOP = "stop"
    WHERE = "where"
    RELAX = "relax"
    WHO = "who"


@dataclass(frozen=True, slots=True)
class Request:
    """A request from another process.

    Attributes:
        do: The command.
        secret: Proves that the client is the same user if the socket has no permissions.
    """

    do: ControlCommand
    secret: str = ""


def encode_request(request: Request) -> bytes:
    """Encode a request as one line."""
    return _encode_line({"schema": SCHEMA, "do": request.do.value, "secret": request.secret})


def decode_request(line: bytes) -> Request:
    """Decode a request from a line.

    Raises:
        InputError: The line is too long, not JSON, or not a request of this schema.
    """
    row = _decode_line(line, MAX_REQUEST_BYTES)
    if row.keys() != _KEYS or row["schema"] != SCHEMA:
        raise _message_error(f"expected the keys {', '.join(sorted(_KEYS))} of {SCHEMA}")
    if row["do"] not in list(ControlCommand) or not isinstance(row["secret"], str):
        raise _message_error(f"the commands are {', '.join(ControlCommand)}")
    return Request(ControlCommand(row["do"]), row["secret"])


def encode_reply(fields: Mapping[str, object]) -> bytes:
    """Encode a reply as one line."""
    return _encode_line({"schema": SCHEMA, **fields})


def decode_reply(line: bytes) -> dict[str, Any]:
    """Decode the fields of a reply.

    Raises:
        InputError: The reply is not a reply of this schema.
    """
    row = _decode_line(line, MAX_REPLY_BYTES)
    if row.pop("schema", None) != SCHEMA:
        raise _message_error(f"expected a reply of {SCHEMA}")
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
    except (ValueError, RecursionError):  # not UTF-8, not JSON, a number too long, nested too deep
        raise _message_error("expected one line of JSON") from None
    if not isinstance(row, dict):
        raise _message_error("expected an object")
    return cast("dict[str, Any]", row)


def _message_error(why: str) -> InputError:
    return InputError(f"Not a valid message between ikservo programs: {why}.", "Nothing was done.")


@dataclass(frozen=True, slots=True)
class StopResult:
    """The outcome of stopping an arm.

    Attributes:
        arm: The name of the arm.
        port: The port of the arm.
        moving: Whether another program was moving the arm.
        held: The joints that hold.
        limp: Joints without torque; their servos were not changed.
        silent: Joints that did not reply.
        latched: Whether a program has the arm and moves it only once the stop is acknowledged.
    """

    arm: str
    port: str
    moving: bool
    held: tuple[str, ...]
    limp: tuple[str, ...]
    silent: tuple[str, ...]
    latched: bool = True

    @classmethod
    def of(cls, result: object) -> StopResult:
        """Read the outcome in the reply to a stop, without importing the slow ``result_json``.

        Raises:
            IkservoError: The reply is from a different version.
        """
        match cast("Any", result):
            case {
                "value": {
                    "arm": str(arm),
                    "port": str(port),
                    "moving": bool(moving),
                    "held": held,
                    "limp": limp,
                    "silent": silent,
                }
            } if all(map(_is_names, (held, limp, silent))):
                return cls(arm, port, moving, tuple(held), tuple(limp), tuple(silent))
            case _:
                raise other_version_error()


@dataclass(frozen=True, slots=True)
class StopAllResult:
    """The arms that have confirmed a stop, and an error for each other arm."""

    stopped: tuple[StopResult, ...] = ()
    errors: tuple[IkservoError, ...] = ()

    @classmethod
    def joined(cls, results: Iterable[StopAllResult]) -> StopAllResult:
        """Join several outcomes into one."""
        found = tuple(results)
        return cls(
            tuple(stopped for each in found for stopped in each.stopped),
            tuple(error for each in found for error in each.errors),
        )


def send_command(
    device: str, command: ControlCommand, timeout_s: float = 10.0, arm: str = ""
) -> Any:  # noqa: ANN401  # any JSON value
    """Send a command to the process that has a device open.

    ``device`` is any name of the device; ``arm`` is needed if the process has two arms on it.

    Returns:
        The result as JSON values, or None if no process listens.

    Raises:
        IkservoError: The command failed in that process, with this message and exit code.
    """
    own = _request_at(socket_path(device, arm), device, command, timeout_s) if arm else None
    return own or _request_at(socket_path(device), device, command, timeout_s)


def broadcast_command(command: ControlCommand, timeout_s: float = 10.0) -> list[Any]:
    """Send a command to every process of this user that has a device open.

    Returns:
        The result as JSON values, or the ``IkservoError``, from each process that listens.
    """

    def request(path: Path) -> object:
        try:
            return _request_at(path, "a port", command, timeout_s)
        except IkservoError as error:
            return error

    with ThreadPoolExecutor() as pool:  # a process without a reply must not delay the others
        replies = list(pool.map(request, socket_paths()))
    return [reply for reply in replies if reply is not None]


def _request_at(path: Path, device: str, command: ControlCommand, timeout_s: float) -> object:
    try:
        found = connect(path, timeout_s)
        if found is None:
            return None
        connection, secret = found
        with connection:
            reply = _exchange_lines(connection, Request(command, secret), timeout_s)
        return result_in(decode_reply(reply))
    except IkservoError:
        raise
    except OSError as error:
        raise IkservoError(
            f"The program that has {device} open does not answer ({error}).",
            "End that program and try again.",
        ) from None


def _exchange_lines(connection: socket.socket, request: Request, timeout_s: float) -> bytes:
    deadline_s, reply = time.monotonic() + timeout_s, b""
    with contextlib.suppress(BrokenPipeError):  # disconnected early; its reply may still be there
        connection.sendall(encode_request(request))
    while not reply.endswith(b"\n") and len(reply) <= MAX_REPLY_BYTES:
        connection.settimeout(max(1e-3, deadline_s - time.monotonic()))
        piece = connection.recv(MAX_REPLY_BYTES + 1 - len(reply))
        if not piece:
            raise ConnectionError("it has too many connections, or has just ended")
        reply += piece
    return reply


def request_stop(device: str, arm: str) -> StopResult | None:
    """Stop an arm through the program that has its port open; return None if no program has.

    Raises:
        IkservoError: That program cannot stop the arm.
    """
    leave_mark(device, arm)
    reply = send_command(device, ControlCommand.STOP, BRAKE_TIMEOUT_S + 2.0, arm)
    return None if reply is None else StopResult.of(reply)


def request_stop_of(arm: str) -> StopAllResult:
    """Stop an arm by name in every program of this user that has it open or is opening it."""
    leave_mark(arm=arm)
    ports: set[str] = set()
    for reply in broadcast_command(ControlCommand.WHO, _WHO_TIMEOUT_S):
        match reply:
            case {"arm": str(name), "port": str(port)} if name == arm:
                ports.add(port)
            case _:
                pass  # a program with another arm
    stopped = (request_stop(port, arm) for port in sorted(ports))
    return StopAllResult(tuple(each for each in stopped if each is not None))


def stop_own_programs() -> StopAllResult:
    """Stop every arm whose port is open, or about to be opened, by a program of this user."""
    leave_mark()
    stopped: list[StopResult] = []
    errors: list[IkservoError] = []
    for reply in broadcast_command(ControlCommand.STOP, BRAKE_TIMEOUT_S + 2.0):
        if isinstance(reply, IkservoError):
            errors.append(reply)
            continue
        try:
            stopped.append(StopResult.of(reply))
        except IkservoError as error:
            errors.append(error)
    return StopAllResult(tuple(stopped), tuple(errors))


def _is_names(value: object) -> bool:
    return isinstance(value, list) and all(isinstance(n, str) for n in cast("list[object]", value))

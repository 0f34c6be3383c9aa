"""Asking the owner of a bus from another process."""

from __future__ import annotations

import contextlib
import socket
import time
from pathlib import Path
from typing import Any

from ikservo.arm.owner.door import knock
from ikservo.arm.owner.message import LONGEST_ANSWER, Errand, Request, read_answer, request_line
from ikservo.arm.owner.place import place_of, places
from ikservo.errors import ExitCode, IkservoError

__all__ = ["ask", "ask_all"]


def ask(device: str, errand: Errand, timeout_s: float = 10.0) -> dict[str, Any] | None:
    """Let the process that has a device open do an errand.

    Args:
        device: The port, by any of its names.
        errand: What shall be done.
        timeout_s: How long the answer may take; relaxing is slow.

    Returns:
        The fields of the answer, or None where nobody listens.

    Raises:
        IkservoError: The owner could not or would not; carries its words and its exit code.
    """
    return _asked(place_of(device), device, errand, timeout_s)


def ask_all(errand: Errand, timeout_s: float = 10.0) -> list[dict[str, Any] | IkservoError]:
    """Let every process of this user that has a device open do an errand.

    Returns:
        An answer, or an error, for each that listens.
    """
    answers: list[dict[str, Any] | IkservoError] = []
    for place in places():
        try:
            answer = _asked(place, "a port", errand, timeout_s)
        except IkservoError as error:
            answers.append(error)
        else:
            answers += [answer] if answer is not None else []
    return answers


def _asked(place: Path, device: str, errand: Errand, timeout_s: float) -> dict[str, Any] | None:
    try:
        found = knock(place, timeout_s)
        if found is None:
            return None
        connection, secret = found
        with connection:
            return _fields(_conversation(connection, Request(errand, secret), timeout_s))
    except IkservoError:
        raise
    except OSError as error:
        raise IkservoError(
            f"The program that has {device} open does not answer ({error}).",
            "End it and try again.",
        ) from None


def _conversation(connection: socket.socket, request: Request, timeout_s: float) -> bytes:
    deadline_s, answer = time.monotonic() + timeout_s, b""
    with contextlib.suppress(BrokenPipeError):  # sent away at once; its answer may still wait
        connection.sendall(request_line(request))
    while not answer.endswith(b"\n") and len(answer) <= LONGEST_ANSWER:
        connection.settimeout(max(1e-3, deadline_s - time.monotonic()))
        piece = connection.recv(LONGEST_ANSWER + 1 - len(answer))
        if not piece:
            raise ConnectionError("it has too many callers, or has just ended")
        answer += piece
    return answer


def _fields(answer: bytes) -> dict[str, Any]:
    fields = read_answer(answer)
    if "error" not in fields:
        return fields
    error = IkservoError(str(fields["error"]), str(fields.get("hint", "")))
    with contextlib.suppress(ValueError):
        error.exit_code = ExitCode(int(fields.get("exit_code", 1)))
    raise error

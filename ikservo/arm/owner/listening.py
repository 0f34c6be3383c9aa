"""The owner's ear: a thread that takes requests, so that the control loop never waits for one."""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Mapping

from ikservo.arm.owner.door import Door, knock, open_door
from ikservo.arm.owner.message import LONGEST_REQUEST, Request, answer_line, read_request
from ikservo.arm.owner.place import place_of
from ikservo.errors import IkservoError, RefusedError
from ikservo.hardware.line.forking import abandon_in_forked_children

__all__ = ["Answer", "Listener", "listen"]

Answer = Callable[[Request], Mapping[str, object]]
"""Does what a request asks and returns the fields of the answer; called in threads of its own."""

_MOST_CALLERS = 16
_SAY_IT_WITHIN_S = 1.0  # a caller that takes longer for its one line is sent away


def listen(device: str, answer: Answer) -> Listener | None:
    """Listen for the callers of a device that this process has opened.

    Returns:
        The listener, or None where the system offers no safe place for one: an arm works without.
    """
    try:
        door = open_door(place_of(device))
    except (OSError, IkservoError):
        return None
    return Listener(door, answer) if door else None


class Listener:
    """Answers callers until it is closed; each one in a thread, a few at a time.

    Args:
        door: What is listened on.
        answer: Does the errands.
    """

    def __init__(self, door: Door, answer: Answer) -> None:
        self._door, self._answer = door, answer
        self._free = threading.BoundedSemaphore(_MOST_CALLERS)
        self._closing = False
        self._thread = threading.Thread(target=self._serve, name="ikservo-owner", daemon=True)
        self._thread.start()
        abandon_in_forked_children(self)

    def abandon(self) -> None:
        """Close a forked child's copy of the socket: its parent goes on listening."""
        self._closing = True
        self._door.socket.close()

    def close(self) -> None:
        """Stop listening; callers that are being answered get a second for that."""
        if self._closing:
            return
        self._closing = True
        with contextlib.suppress(OSError):
            woken = knock(self._door.place, 0.5)  # accept has no other way of being interrupted
            if woken:
                woken[0].close()
        self._thread.join(1.0)
        self._door.close()
        deadline_s = time.monotonic() + _SAY_IT_WITHIN_S
        for _ in range(_MOST_CALLERS):
            self._free.acquire(timeout=max(0.0, deadline_s - time.monotonic()))

    def _serve(self) -> None:
        while not self._closing:
            try:
                connection, _ = self._door.socket.accept()
            except OSError:
                return
            if self._closing or not self._free.acquire(blocking=False):
                connection.close()
                continue
            threading.Thread(target=self._attend, args=(connection,), daemon=True).start()

    def _attend(self, connection: socket.socket) -> None:
        try:
            with connection, contextlib.suppress(OSError):  # a caller that is too slow, or gone
                line = _line_from(connection)
                fields = self._reply(connection, line)
                connection.settimeout(_SAY_IT_WITHIN_S)
                connection.sendall(answer_line(fields))
        finally:
            self._free.release()

    def _reply(self, connection: socket.socket, line: bytes) -> Mapping[str, object]:
        try:
            request = read_request(line)
            if not self._door.admits(connection, request.secret):
                raise RefusedError("The arm belongs to another user.", "Nothing was done.")
            return self._answer(request)
        except IkservoError as error:
            return _failed(error)
        except Exception as error:  # a caller must not end the owner's program
            return _failed(IkservoError(f"It failed: {type(error).__name__}: {error}."))


def _line_from(connection: socket.socket) -> bytes:
    """Return the first line, or what came of it in time, one byte more than allowed at most."""
    deadline_s, line = time.monotonic() + _SAY_IT_WITHIN_S, b""
    while not line.endswith(b"\n") and len(line) <= LONGEST_REQUEST:
        connection.settimeout(max(1e-3, deadline_s - time.monotonic()))
        piece = connection.recv(LONGEST_REQUEST + 1 - len(line))
        if not piece:
            break
        line += piece
        if time.monotonic() > deadline_s:
            raise TimeoutError
    return line


def _failed(error: IkservoError) -> Mapping[str, object]:
    return {"error": error.message, "hint": error.command_hint, "exit_code": int(error.exit_code)}

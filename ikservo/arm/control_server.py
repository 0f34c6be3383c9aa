"""The control server of an open arm: stop, state and relax requests from other processes.

The messages are those of ``control_client``; anything else is refused.
"""

from __future__ import annotations

import contextlib
import socket
import threading
import time
from collections.abc import Callable, Generator, Mapping
from contextlib import contextmanager
from dataclasses import asdict
from threading import RLock
from typing import Protocol

from ikservo.arm.control_client import (
    BRAKE_TIMEOUT_S,
    MAX_REQUEST_BYTES,
    Command,
    Request,
    decode_request,
    encode_reply,
)
from ikservo.arm.control_socket import ListeningSocket, connect, open_socket, socket_path
from ikservo.arm.reports import ArmState, JointMoveResult
from ikservo.control.stopping import StopOutcome
from ikservo.errors import IkservoError, RefusedError
from ikservo.guard import StopKind, StopReason
from ikservo.hardware.transport import abandon_in_forked_children

__all__ = [
    "CommandHandler",
    "ControlServer",
    "RemoteTarget",
    "RequestHandler",
    "serve",
]


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


_STOPPED = StopReason(StopKind.CLIENT, "Stopped from another terminal; torque stays on.")
_STOPPED_AT_REST = StopReason(StopKind.CLIENT, "Stopped from another terminal.")
_RELAXED = StopReason(StopKind.RELEASED, "Torque switched off from another terminal.")


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
            case Command.WHO:
                return {"arm": self._target.arm_name, "port": self._target.port_name}

    def _handle_stop(self) -> Mapping[str, object]:
        target = self._target
        moving = False
        if not target.lock.acquire(blocking=False):  # a motion, or a thread that reads servos
            target.request_stop(_STOPPED if target.motion_running else _STOPPED_AT_REST)
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

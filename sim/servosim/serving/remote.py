"""Remote control: a unix socket that takes one JSON object a line and answers likewise.

>>> {"do": "state"}
>>> {"do": "place", "joint": "elbow_flex", "deg": 30}
>>> {"do": "hand", "joint": "elbow_flex", "deg": 60, "force": 2}
>>> {"do": "hand", "joint": "elbow_flex", "release": true}
>>> {"do": "hand", "tip_m": [0.28, 0.05, 0.0]}    {"do": "hand", "release": true}
>>> {"do": "fault", "fault": {"kind": "silent", "id": 3, "for_s": 1}}
>>> {"do": "unplug"}    {"do": "replug"}    {"do": "brownout", "for_s": 0.5}
>>> {"do": "disconnect", "servo": 2}    {"do": "connect", "servo": 2}
>>> {"do": "temperature", "id": 3, "celsius": 75}    {"do": "voltage", "volts": 6.0}
>>> {"do": "reset", "id": 3}    {"do": "quit"}
"""

from __future__ import annotations

import json
import math
import socket
from collections.abc import Callable
from pathlib import Path
from typing import Any

from servosim.errors import SimulatorError
from servosim.faults import Fault
from servosim.hand import HAND_SPEED, Hand, glide
from servosim.line import Line
from servosim.serving.state import joint_state, servo_state

__all__ = ["Remote"]

Request = dict[str, Any]
_UNFIT = (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError)


class Remote:
    """Listens on a socket, if there is one, between two looks at the line."""

    def __init__(self, path: Path | None, line: Line) -> None:
        self._path, self._line = path, line
        self._server: socket.socket | None = None
        self._clients: dict[int, tuple[socket.socket, bytearray]] = {}
        self._quit = False

    def __enter__(self) -> Remote:
        if self._path is not None:
            self._server = _listen(self._path)
        return self

    def __exit__(self, *_: object) -> None:
        for client, _buffer in self._clients.values():
            client.close()
        if self._server is not None and self._path is not None:
            self._server.close()
            self._path.unlink(missing_ok=True)

    def sockets(self) -> list[int]:
        """Return the file descriptors to wait for."""
        return [*([self._server.fileno()] if self._server else []), *self._clients]

    def serve(self, ready: list[int]) -> bool:
        """Answer what has come; true when somebody wants the server to end."""
        for fd in ready:
            if fd in self._clients:
                self._receive(fd)
            elif self._server is not None and fd == self._server.fileno():
                client = self._server.accept()[0]
                client.setblocking(False)  # who does not read his answers is hung up on
                self._clients[client.fileno()] = (client, bytearray())
        return self._quit

    def answer(self, text: str | bytes) -> Request:
        """Do what one line asks; return the answer."""
        try:
            request: Request = json.loads(text)
            return {"ok": True, **self._do(request)}
        except (SimulatorError, *_UNFIT) as error:
            reason = f"{error} is missing" if isinstance(error, KeyError) else str(error)
            return {"ok": False, "error": reason}

    def _receive(self, fd: int) -> None:
        client, buffer = self._clients[fd]
        try:
            data = client.recv(65536)
            buffer += data
            while b"\n" in buffer:
                line, _, rest = bytes(buffer).partition(b"\n")
                buffer[:] = rest
                client.sendall(json.dumps(self.answer(line)).encode() + b"\n")
        except OSError:
            data = b""
        if not data:
            client.close()
            del self._clients[fd]

    def _do(self, request: Request) -> Request:
        actions: dict[str, Callable[[Request], Request | None]] = {
            "state": self._state,
            "place": self._place,
            "hand": self._hand,
            "fault": self._fault,
            "unplug": lambda _: self._plug(plugged=False),
            "replug": lambda _: self._plug(plugged=True),
            "disconnect": lambda r: self._connect(r, connected=False),
            "connect": lambda r: self._connect(r, connected=True),
            "quit": self._end,
            **dict.fromkeys(("brownout", "voltage", "reset"), self._event),
            "temperature": lambda r: self._event({**r, "do": "hot"}),
        }
        name = request["do"]
        if name not in actions:
            raise SimulatorError(f"cannot do {name!r}; can: {', '.join(actions)}")
        return actions[name](request) or {}

    def _state(self, _: Request) -> Request:
        world = self._line.world
        servos = [servo_state(joint, servo) for joint in world.joints for servo in joint.servos]
        joints = {joint.name: joint_state(joint) for joint in world.joints}
        state: Request = {"time_s": world.time_s, "servos": servos, "joints": joints}
        if world.tip is not None:
            positions = [joint.position for joint in world.joints]
            state["tip_m"] = world.tip.position_m(positions).tolist()
        return state

    def _place(self, request: Request) -> None:
        self._line.world.place(request["joint"], _coordinate(request))

    def _hand(self, request: Request) -> None:
        world = self._line.world
        if request.get("release"):
            self._release(request)
            return
        if "tip_m" in request:
            self._lead_tip(request)
            return
        name = request["joint"]
        joint = world.joint(name)
        speed = HAND_SPEED / 10 if joint.slides else HAND_SPEED
        speed = _finite(request.get("speed", speed), "speed", above=0.0)
        force = _finite(request.get("force", 2.0), "force", above=0.0)
        path = glide(joint.position, _coordinate(request), speed)
        world.grasp(name, Hand(path, limit=force))

    def _release(self, request: Request) -> None:
        """Let go of one joint, or of all."""
        world = self._line.world
        named = [world.joint(request["joint"]).name] if "joint" in request else [*world.hands]
        for name in named:
            world.release(name)

    def _lead_tip(self, request: Request) -> None:
        point_m = [_finite(value, "tip_m") for value in request["tip_m"]]
        if len(point_m) != 3:
            raise SimulatorError(f"tip_m = {point_m} is no point; try [0.25, 0.05, 0.1]")
        speed = _finite(request.get("speed", HAND_SPEED), "speed", above=0.0)
        force = _finite(request.get("force", 10.0), "force", above=0.0)
        self._line.world.lead_tip(point_m, speed, force)

    def _fault(self, request: Request) -> None:
        fault = Fault.of({"at_s": self._line.world.time_s, **request["fault"]})
        if fault.id is not None and fault.id not in self._line.servos:
            raise SimulatorError(f"no servo has id {fault.id}")
        self._line.faults.add(fault)

    def _event(self, request: Request) -> None:
        """Start a fault of the same name now; the keys are the fault's."""
        keys = {key: value for key, value in request.items() if key != "do"}
        self._fault({"fault": {"kind": request["do"], **keys}})

    def _plug(self, *, plugged: bool) -> None:
        self._line.plugged = plugged

    def _connect(self, request: Request, *, connected: bool) -> None:
        """Put the plug of one servo, counted from 1 along the bus, in or out: line and supply."""
        servos, place = self._line.world.servos, request["servo"]
        if not (isinstance(place, int) and 1 <= place <= len(servos)):
            raise SimulatorError(f"servo = {place!r} is not one of 1 to {len(servos)}")
        servo = servos[place - 1]
        if connected and not servo.powered:
            servo.power_up()
        elif not connected:
            servo.power_down()

    def _end(self, _: Request) -> None:
        self._quit = True


def _listen(path: Path) -> socket.socket:
    """Return a socket that listens at a path; an older socket gives way, anything else does not."""
    if path.exists() and not path.is_socket():
        raise SimulatorError(f"{path} is there already and is no socket; choose another name")
    path.unlink(missing_ok=True)
    server = socket.socket(socket.AF_UNIX)
    server.setblocking(False)
    try:
        server.bind(str(path))
    except OSError as error:
        server.close()
        raise SimulatorError(f"{path}: {error}") from error
    server.listen()
    return server


def _coordinate(request: Request) -> float:
    """Return the joint coordinate that a request names in degrees, radians or metres."""
    if "deg" in request:
        return math.radians(_finite(request["deg"], "deg"))
    name = "rad" if "rad" in request else "m"
    return _finite(request[name], name)


def _finite(value: float | str, name: str, above: float = -math.inf) -> float:
    number = float(value)
    if not above < number < math.inf:
        raise SimulatorError(f"{name} = {value!r} will not do")
    return number

"""Remote control of a running simulator: one JSON object per line, and its state as JSON.

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
from servosim.joint import HAND_SPEED, Hand, SimulatedJoint, glide
from servosim.line import Line
from servosim.own_files import MAX_BYTES, parse_json
from servosim.servo import Servo


def servo_state(joint: SimulatedJoint, servo: Servo) -> dict[str, Any]:
    """Return a servo's registers and motor state; positions in ticks of its registers."""
    motor = servo.motor
    return {
        "id": servo.id,
        "model": servo.table.model,
        "joint": joint.name,
        "position": servo.read("present_position"),
        "goal": servo.read("goal_position"),
        "torque": servo.drive.torque_on,
        "moving": motor.moving,
        "load": motor.torque_nm / motor.parameters.stall_torque_nm,
        "current_a": motor.current_a,
        "temperature_c": motor.temperature_c,
        "voltage_v": servo.supply_v,
        "alarm": servo.alarm,
        "powered": servo.powered,
        "baud": servo.baud,
    }


def joint_state(joint: SimulatedJoint) -> dict[str, Any]:
    """Return the true state of a joint: degrees if it is revolute, metres if prismatic."""
    if joint.is_prismatic:
        return {"position_m": joint.position, "velocity_m_s": joint.velocity}
    return {
        "position_deg": math.degrees(joint.position),
        "velocity_deg_s": math.degrees(joint.velocity),
    }


Request = dict[str, Any]
_INVALID_REQUEST = (ValueError, KeyError, TypeError, AttributeError, OverflowError, RecursionError)


class RemoteControl:
    """Serves requests on a socket, if there is one, between two steps of the line."""

    def __init__(self, path: Path | None, line: Line) -> None:
        self._path, self._line = path, line
        self._server: socket.socket | None = None
        self._clients: dict[int, tuple[socket.socket, bytearray]] = {}
        self._quit = False

    def __enter__(self) -> RemoteControl:
        if self._path is not None:
            self._server = _listen_at(self._path)
        return self

    def __exit__(self, *_: object) -> None:
        for client, _buffer in self._clients.values():
            client.close()
        if self._server is not None and self._path is not None:
            self._server.close()
            self._path.unlink(missing_ok=True)

    def socket_fds(self) -> list[int]:
        """Return the file descriptors to wait for."""
        return [*([self._server.fileno()] if self._server else []), *self._clients]

    def serve(self, ready: list[int]) -> bool:
        """Serve received requests; return whether a client asked the server to shut down."""
        for fd in ready:
            if fd in self._clients:
                self._receive_line(fd)
            elif self._server is not None and fd == self._server.fileno():
                client = self._server.accept()[0]
                client.setblocking(False)  # a client that does not read is disconnected
                self._clients[client.fileno()] = (client, bytearray())
        return self._quit

    def respond(self, text: str | bytes) -> Request:
        """Execute one line; return the response."""
        try:
            request: Request = parse_json(text)
            return {"ok": True, **self._execute_request(request)}
        except (SimulatorError, *_INVALID_REQUEST) as error:
            reason = f"{error} is missing" if isinstance(error, KeyError) else str(error)
            return {"ok": False, "error": reason}

    def _receive_line(self, fd: int) -> None:
        client, buffer = self._clients[fd]
        try:
            data = client.recv(65536)
            buffer += data
            while b"\n" in buffer:
                line, _, rest = bytes(buffer).partition(b"\n")
                buffer[:] = rest
                client.sendall(json.dumps(self.respond(line)).encode() + b"\n")
            if len(buffer) > MAX_BYTES:  # the line has no end
                data = b""
        except OSError:
            data = b""
        if not data:
            client.close()
            del self._clients[fd]

    def _execute_request(self, request: Request) -> Request:
        actions: dict[str, Callable[[Request], Request | None]] = {
            "state": self._get_state,
            "place": self._place_joint,
            "hand": self._apply_hand,
            "fault": self._add_fault,
            "unplug": lambda _: self._set_plugged(plugged=False),
            "replug": lambda _: self._set_plugged(plugged=True),
            "disconnect": lambda r: self._set_servo_connected(r, connected=False),
            "connect": lambda r: self._set_servo_connected(r, connected=True),
            "quit": self._request_end,
            **dict.fromkeys(("brownout", "voltage", "reset"), self._start_event),
            "temperature": lambda r: self._start_event({**r, "do": "hot"}),
        }
        name = request["do"]
        if name not in actions:
            raise SimulatorError(f"unknown request {name!r}; known: {', '.join(actions)}")
        return actions[name](request) or {}

    def _get_state(self, _: Request) -> Request:
        world = self._line.world
        servos = [servo_state(joint, servo) for joint in world.joints for servo in joint.servos]
        joints = {joint.name: joint_state(joint) for joint in world.joints}
        state: Request = {"time_s": world.time_s, "servos": servos, "joints": joints}
        if world.tip is not None:
            positions = [joint.position for joint in world.joints]
            state["tip_m"] = world.tip.position_m(positions).tolist()
        return state

    def _place_joint(self, request: Request) -> None:
        self._line.world.place(request["joint"], _parse_coordinate(request))

    def _apply_hand(self, request: Request) -> None:
        world = self._line.world
        if request.get("release"):
            self._release(request)
            return
        if "tip_m" in request:
            self._lead_tip(request)
            return
        name = request["joint"]
        joint = world.joint(name)
        speed = HAND_SPEED / 10 if joint.is_prismatic else HAND_SPEED
        speed = _require_finite(request.get("speed", speed), "speed", above=0.0)
        force = _require_finite(request.get("force", 2.0), "force", above=0.0)
        path = glide(joint.position, _parse_coordinate(request), speed)
        world.grasp(name, Hand(path, limit=force))

    def _release(self, request: Request) -> None:
        """Release one joint, or all."""
        world = self._line.world
        named = [world.joint(request["joint"]).name] if "joint" in request else [*world.hands]
        for name in named:
            world.release(name)

    def _lead_tip(self, request: Request) -> None:
        point_m = [_require_finite(value, "tip_m") for value in request["tip_m"]]
        if len(point_m) != 3:
            raise SimulatorError(f"tip_m = {point_m} is not a point; try [0.25, 0.05, 0.1]")
        speed = _require_finite(request.get("speed", HAND_SPEED), "speed", above=0.0)
        force = _require_finite(request.get("force", 10.0), "force", above=0.0)
        self._line.world.lead_tip(point_m, speed, force)

    def _add_fault(self, request: Request) -> None:
        fault = Fault.from_table({"at_s": self._line.world.time_s, **request["fault"]})
        if fault.id is not None and fault.id not in self._line.servos:
            raise SimulatorError(f"no servo has id {fault.id}")
        self._line.faults.add(fault)

    def _start_event(self, request: Request) -> None:
        """Start the fault of this name now; the keys of the request are those of the fault."""
        keys = {key: value for key, value in request.items() if key != "do"}
        self._add_fault({"fault": {"kind": request["do"], **keys}})

    def _set_plugged(self, *, plugged: bool) -> None:
        self._line.plugged = plugged

    def _set_servo_connected(self, request: Request, *, connected: bool) -> None:
        """Connect or disconnect line and supply of a servo, counted from 1 along the bus."""
        servos, place = self._line.world.servos, request["servo"]
        if not (isinstance(place, int) and 1 <= place <= len(servos)):
            raise SimulatorError(f"servo = {place!r} is not one of 1 to {len(servos)}")
        servo = servos[place - 1]
        if connected and not servo.powered:
            servo.power_up()
        elif not connected:
            servo.power_down()

    def _request_end(self, _: Request) -> None:
        self._quit = True


def _listen_at(path: Path) -> socket.socket:
    """Return a socket listening at a path; an older socket is replaced, anything else is kept."""
    if path.exists() and not path.is_socket():
        raise SimulatorError(f"{path} already exists and is not a socket; choose another name")
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


def _parse_coordinate(request: Request) -> float:
    """Parse the joint coordinate that a request gives in degrees, radians or metres."""
    if "deg" in request:
        return math.radians(_require_finite(request["deg"], "deg"))
    name = "rad" if "rad" in request else "m"
    return _require_finite(request[name], name)


def _require_finite(value: float | str, name: str, above: float = -math.inf) -> float:
    number = float(value)
    if not above < number < math.inf:
        raise SimulatorError(f"{name} = {value!r} cannot be used")
    return number

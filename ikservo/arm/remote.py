"""Commands to an arm that another process controls: stop it, read its state, relax it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from ikservo.arm.control_server import BRAKE_TIMEOUT_S, Command, broadcast_command, send_command
from ikservo.arm.opening import open_bus, resolve_port
from ikservo.arm.recording import RecordResult, record, recording_header
from ikservo.arm.reports import ArmState, JointMoveResult
from ikservo.clock import Clock, RealClock
from ikservo.control.feedback import JointState
from ikservo.control.stopping import StopOutcome, hold_servos
from ikservo.errors import IkservoError, PortBusyError
from ikservo.guard import CommandLimits
from ikservo.hardware.remembered_port import is_simulated
from ikservo.kinematics.arrays import Vector, as_floats
from ikservo.model import Model

__all__ = [
    "StopResult",
    "query_state",
    "record_remote",
    "request_relax",
    "stop_all_arms",
    "stop_arm",
]

_RELAX_TIMEOUT_S = 120.0
# Between opening a port and listening a program reads all of its servos.
_START_TIMEOUT_S, _RETRY_PERIOD_S = 3.0, 0.02

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class StopResult:
    """The outcome of stopping an arm.

    Attributes:
        arm: Its name.
        port: Its port.
        moving: Whether another program was moving it.
        held: The joints that hold.
        limp: Those without torque; nothing was changed there.
        silent: Those that did not reply.
    """

    arm: str
    port: str
    moving: bool
    held: tuple[str, ...]
    limp: tuple[str, ...]
    silent: tuple[str, ...]


_STOPPED_FIELDS = TypeAdapter(StopResult)
# Checks the types of the values; the names of the fields are checked by the class.
_JOINT_REPORT = TypeAdapter[dict[str, Any]](
    dict[str, bool | float | dict[str, float] | tuple[str, ...]]
)


def stop_arm(model: Model, port: str | None, clock: Clock | None = None) -> StopResult:
    """Stop an arm: by a command to the program that has its port open, else on the port itself.

    Args:
        model: The arm.
        port: Its port; chosen as for every command if None.
        clock: Measures how long to wait for a program that does not listen yet.

    Raises:
        IkservoError: That program cannot, or the port cannot be opened.
    """
    device = resolve_port(model, port)
    clock = clock or RealClock()
    until_s = clock.now_s() + _START_TIMEOUT_S
    while True:
        reply = _request(device, Command.STOP, BRAKE_TIMEOUT_S + 2.0)
        if reply is not None:
            return _validate_reply(_STOPPED_FIELDS, reply)
        try:
            outcome = halt_line(model, port)
        except PortBusyError:  # a program that has just opened it, and does not listen yet
            if clock.now_s() > until_s:
                raise
            clock.sleep_until(clock.now_s() + _RETRY_PERIOD_S)
        else:
            return StopResult(model.name, device, False, outcome.held, outcome.limp, outcome.silent)


def stop_all_arms() -> list[StopResult]:
    """Stop every arm whose port a program of this user has open.

    Raises:
        IkservoError: One of them could not be stopped; the others were.
    """
    replies = broadcast_command(Command.STOP, BRAKE_TIMEOUT_S + 2.0)
    for reply in replies:
        if isinstance(reply, IkservoError):
            raise reply
    return [_validate_reply(_STOPPED_FIELDS, reply) for reply in replies]


def query_state(model: Model, port: str | None) -> ArmState | None:
    """Request an arm's state from the program that has its port open; None where none has.

    Raises:
        IkservoError: That program cannot.
    """
    reply = _request(resolve_port(model, port), Command.WHERE, 10.0)
    if reply is None:
        return None
    joints = _validate_reply(TypeAdapter(tuple[JointState, ...]), reply.get("joints"))
    return ArmState(as_floats(reply.get("tip_m", ()), "The tip", "three numbers"), joints)


def request_relax(model: Model, port: str | None) -> JointMoveResult | None:
    """Let the program that has an arm's port open relax it; return None where none has.

    Raises:
        IkservoError: That program cannot.
    """
    reply = _request(resolve_port(model, port), Command.RELAX, _RELAX_TIMEOUT_S)
    if reply is None:
        return None
    tip_m = as_floats(reply.pop("measured_tip_m", ()), "The tip", "three numbers")
    fields = _validate_reply(_JOINT_REPORT, reply)
    try:
        return JointMoveResult(**fields, measured_tip_m=tip_m)
    except TypeError:
        raise _version_error() from None


def record_remote(
    model: Model,
    port: str | None,
    path: Path,
    duration_s: float | None,
    until: Callable[[], bool] | None,
    period_s: float,
    *,
    overwrite: bool,
) -> RecordResult | None:
    """Record an arm that another program moves, by state requests; None where none has its port.

    Raises:
        IkservoError: That program has ended, or the file cannot be written.
    """
    if query_state(model, port) is None:
        return None

    def measure() -> Vector:
        state = query_state(model, port)
        if state is None:
            raise IkservoError(
                "The program that moved the arm has ended.", "The recording up to then is kept."
            )
        return np.array([joint.position_rad for joint in state.joints])

    header = recording_header(model, period_s)
    return record(measure, RealClock(), path, header, duration_s, until, overwrite=overwrite)


def _request(device: str, command: Command, timeout_s: float) -> dict[str, Any] | None:
    return None if is_simulated(device) else send_command(device, command, timeout_s)


def _validate_reply(adapter: TypeAdapter[T], value: object) -> T:
    try:
        return adapter.validate_python(value)
    except ValidationError:
        raise _version_error() from None


def _version_error() -> IkservoError:
    return IkservoError(
        "The program that has the port open sent an unexpected reply.",
        "It may be another version of ikservo. End it and try again.",
    )


def halt_line(model: Model, port: str | None) -> StopOutcome:
    """Open the port of an arm that no program has open, and hold every joint that has torque.

    Neither models nor calibration are checked: whatever moves is stopped.

    Raises:
        PortError: The port cannot be opened.
    """
    fences = [CommandLimits(joint.joint_map, joint.limits, 1.0) for joint in model.joints]
    with open_bus(model, port) as bus:
        return hold_servos(bus, fences, bus.port.clock)

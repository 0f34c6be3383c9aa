"""Commands to an arm that another process controls: stop it, read its state, relax it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from ikservo.arm.calibrated_arm import is_simulated
from ikservo.arm.control_server import BRAKE_TIMEOUT_S, Command, broadcast_command, send_command
from ikservo.arm.opening import open_bus, resolve_port
from ikservo.arm.recording import RecordResult, record, recording_header
from ikservo.arm.reports import ArmState, JointMoveResult
from ikservo.clock import Clock, RealClock
from ikservo.control.feedback import JointState
from ikservo.control.stopping import StopOutcome, hold_servos
from ikservo.errors import IkservoError, PortBusyError
from ikservo.guard import CommandLimits
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
# Between opening a port and listening a program looks at all of its servos.
_START_TIMEOUT_S, _RETRY_PERIOD_S = 3.0, 0.02

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class StopResult:
    """What became of an arm that was stopped from here.

    Attributes:
        arm: Its name.
        port: Its port.
        moving: Whether another program was moving it.
        held: The joints that hold now.
        limp: Those without torque; nothing was changed there.
        silent: Those that did not answer; nobody knows.
    """

    arm: str
    port: str
    moving: bool
    held: tuple[str, ...]
    limp: tuple[str, ...]
    silent: tuple[str, ...]


_STOPPED_FIELDS = TypeAdapter(StopResult)
# Whatever is none of its kinds is refused here, and whatever is no field of it by the report.
_JOINT_REPORT = TypeAdapter[dict[str, Any]](
    dict[str, bool | float | dict[str, float] | tuple[str, ...]]
)


def stop_arm(model: Model, port: str | None, clock: Clock | None = None) -> StopResult:
    """Stop an arm: through the program that owns its port, or on the port itself.

    Args:
        model: The arm.
        port: Its port; chosen as for every command if None.
        clock: Measures how long a program that does not listen yet is waited for.

    Raises:
        IkservoError: The owner cannot, or the port cannot be opened.
    """
    device = resolve_port(model, port)
    clock = clock or RealClock()
    until_s = clock.now_s() + _START_TIMEOUT_S
    while True:
        answer = _request_owner(device, Command.STOP, BRAKE_TIMEOUT_S + 2.0)
        if answer is not None:
            return _validate_reply(_STOPPED_FIELDS, answer)
        try:
            halted = halt_line(model, port)
        except PortBusyError:  # a program that has just opened it, and does not listen yet
            if clock.now_s() > until_s:
                raise
            clock.sleep_until(clock.now_s() + _RETRY_PERIOD_S)
        else:
            return StopResult(model.name, device, False, halted.held, halted.limp, halted.silent)


def stop_all_arms() -> list[StopResult]:
    """Stop every arm whose port some program of this user owns.

    Raises:
        IkservoError: One of them could not be stopped; the others were.
    """
    answers = broadcast_command(Command.STOP, BRAKE_TIMEOUT_S + 2.0)
    for answer in answers:
        if isinstance(answer, IkservoError):
            raise answer
    return [_validate_reply(_STOPPED_FIELDS, answer) for answer in answers]


def query_state(model: Model, port: str | None) -> ArmState | None:
    """Let the owner of an arm say where it is; None where nobody owns the port.

    Raises:
        IkservoError: The owner cannot.
    """
    answer = _request_owner(resolve_port(model, port), Command.WHERE, 10.0)
    if answer is None:
        return None
    joints = _validate_reply(TypeAdapter(tuple[JointState, ...]), answer.get("joints"))
    return ArmState(as_floats(answer.get("tip_m", ()), "The tip", "three numbers"), joints)


def request_relax(model: Model, port: str | None) -> JointMoveResult | None:
    """Let the owner of an arm lower and release it; None where nobody owns the port.

    Raises:
        IkservoError: The owner cannot.
    """
    answer = _request_owner(resolve_port(model, port), Command.RELAX, _RELAX_TIMEOUT_S)
    if answer is None:
        return None
    tip_m = as_floats(answer.pop("measured_tip_m", ()), "The tip", "three numbers")
    fields = _validate_reply(_JOINT_REPORT, answer)
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
    """Record an arm that another program moves, by asking that; None where nobody owns the port.

    Raises:
        IkservoError: The owner has ended, or the file cannot be written.
    """
    if query_state(model, port) is None:
        return None

    def measure() -> Vector:
        here = query_state(model, port)
        if here is None:
            raise IkservoError(
                "The program that moved the arm has ended.", "The recording up to then is kept."
            )
        return np.array([joint.position_rad for joint in here.joints])

    header = recording_header(model, period_s)
    return record(measure, RealClock(), path, header, duration_s, until, overwrite=overwrite)


def _request_owner(device: str, errand: Command, timeout_s: float) -> dict[str, Any] | None:
    return None if is_simulated(device) else send_command(device, errand, timeout_s)


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
    """Open the port of an arm that nobody owns, and let every joint with torque stay where it is.

    Neither models nor calibration are looked at: what moves is stopped, whatever it is.

    Raises:
        PortError: The port cannot be opened.
    """
    fences = [CommandLimits(joint.joint_map, joint.limits, 1.0) for joint in model.joints]
    with open_bus(model, port) as bus:
        return hold_servos(bus, fences, bus.port.clock)

"""An arm that another program may own, from here: stop it, ask where it is, relax it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
from pydantic import TypeAdapter, ValidationError

from ikservo.arm.line import chosen_port, open_line
from ikservo.arm.own import simulated
from ikservo.arm.owner import Errand, ask, ask_all
from ikservo.arm.owner.answering import BRAKE_WITHIN_S
from ikservo.arm.owner.halting import Halted, hold_servos
from ikservo.arm.reports import JointReport, Whereabouts
from ikservo.arm.streaming.states import JointState
from ikservo.arm.tapes.recording import RecordReport, heading_of, record
from ikservo.clock import Clock, RealClock
from ikservo.errors import IkservoError, PortBusyError
from ikservo.guard import Fence
from ikservo.kinematics.numbers import numbers
from ikservo.kinematics.se3 import Vector
from ikservo.model import Model

__all__ = [
    "Stopped",
    "ask_to_relax",
    "ask_where",
    "record_from_here",
    "stop_all",
    "stop_from_here",
]

_RELAX_WITHIN_S = 120.0
# Between opening a port and listening a program looks at all of its servos.
_STARTS_WITHIN_S, _ASK_AGAIN_S = 3.0, 0.02

T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Stopped:
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


_STOPPED_FIELDS = TypeAdapter(Stopped)
# Whatever is none of its kinds is refused here, and whatever is no field of it by the report.
_JOINT_REPORT = TypeAdapter[dict[str, Any]](
    dict[str, bool | float | dict[str, float] | tuple[str, ...]]
)


def stop_from_here(model: Model, port: str | None, clock: Clock | None = None) -> Stopped:
    """Stop an arm: through the program that owns its port, or on the port itself.

    Args:
        model: The arm.
        port: Its port; chosen as for every command if None.
        clock: Measures how long a program that does not listen yet is waited for.

    Raises:
        IkservoError: The owner cannot, or the port cannot be opened.
    """
    device = chosen_port(model, port)
    clock = clock or RealClock()
    until_s = clock.now_s() + _STARTS_WITHIN_S
    while True:
        answer = _asked(device, Errand.STOP, BRAKE_WITHIN_S + 2.0)
        if answer is not None:
            return _read(_STOPPED_FIELDS, answer)
        try:
            halted = halt_line(model, port)
        except PortBusyError:  # a program that has just opened it, and does not listen yet
            if clock.now_s() > until_s:
                raise
            clock.sleep_until(clock.now_s() + _ASK_AGAIN_S)
        else:
            return Stopped(model.name, device, False, halted.held, halted.limp, halted.silent)


def stop_all() -> list[Stopped]:
    """Stop every arm whose port some program of this user owns.

    Raises:
        IkservoError: One of them could not be stopped; the others were.
    """
    answers = ask_all(Errand.STOP, BRAKE_WITHIN_S + 2.0)
    for answer in answers:
        if isinstance(answer, IkservoError):
            raise answer
    return [_read(_STOPPED_FIELDS, answer) for answer in answers]


def ask_where(model: Model, port: str | None) -> Whereabouts | None:
    """Let the owner of an arm say where it is; None where nobody owns the port.

    Raises:
        IkservoError: The owner cannot.
    """
    answer = _asked(chosen_port(model, port), Errand.WHERE, 10.0)
    if answer is None:
        return None
    joints = _read(TypeAdapter(tuple[JointState, ...]), answer.get("joints"))
    return Whereabouts(numbers(answer.get("tip_m", ()), "The tip", "three numbers"), joints)


def ask_to_relax(model: Model, port: str | None) -> JointReport | None:
    """Let the owner of an arm lower and release it; None where nobody owns the port.

    Raises:
        IkservoError: The owner cannot.
    """
    answer = _asked(chosen_port(model, port), Errand.RELAX, _RELAX_WITHIN_S)
    if answer is None:
        return None
    tip_m = numbers(answer.pop("measured_tip_m", ()), "The tip", "three numbers")
    fields = _read(_JOINT_REPORT, answer)
    try:
        return JointReport(**fields, measured_tip_m=tip_m)
    except TypeError:
        raise _other_version() from None


def record_from_here(
    model: Model,
    port: str | None,
    path: Path,
    duration_s: float | None,
    until: Callable[[], bool] | None,
    period_s: float,
    *,
    overwrite: bool,
) -> RecordReport | None:
    """Record an arm that another program moves, by asking that; None where nobody owns the port.

    Raises:
        IkservoError: The owner has ended, or the file cannot be written.
    """
    if ask_where(model, port) is None:
        return None

    def measure() -> Vector:
        here = ask_where(model, port)
        if here is None:
            raise IkservoError(
                "The program that moved the arm has ended.", "The recording up to then is kept."
            )
        return np.array([joint.position_rad for joint in here.joints])

    heading = heading_of(model, period_s)
    return record(measure, RealClock(), path, heading, duration_s, until, overwrite=overwrite)


def _asked(device: str, errand: Errand, timeout_s: float) -> dict[str, Any] | None:
    return None if simulated(device) else ask(device, errand, timeout_s)


def _read(adapter: TypeAdapter[T], value: object) -> T:
    try:
        return adapter.validate_python(value)
    except ValidationError:
        raise _other_version() from None


def _other_version() -> IkservoError:
    return IkservoError(
        "The program that has the port open sent an unexpected reply.",
        "It may be another version of ikservo. End it and try again.",
    )


def halt_line(model: Model, port: str | None) -> Halted:
    """Open the port of an arm that nobody owns, and let every joint with torque stay where it is.

    Neither models nor calibration are looked at: what moves is stopped, whatever it is.

    Raises:
        PortError: The port cannot be opened.
    """
    fences = [Fence(joint.joint_map, joint.limits, 1.0) for joint in model.joints]
    with open_line(model, port) as bus:
        return hold_servos(bus, fences, bus.port.clock)

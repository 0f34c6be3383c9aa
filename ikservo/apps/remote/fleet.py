"""State, operator, health and latency of the arms on several machines."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

from ikservo.apps.remote import key_expressions as keys
from ikservo.apps.remote.address import Endpoint
from ikservo.apps.remote.certificates import client_certificate
from ikservo.apps.remote.wire_messages import (
    ServedHealth,
    ServiceRequest,
    encode,
    parse_result,
    result_of,
)
from ikservo.apps.remote.zenoh_session import ask, on_each_host, open_client, served_names
from ikservo.errors import IkservoError

_TIMEOUT_S = 5.0


@dataclass(frozen=True, slots=True)
class FleetArm:
    """An arm of a fleet, or a machine that cannot be reached.

    Attributes:
        host: The machine.
        name: The name under which the arm is served; empty if the machine is unreachable.
        arm: The kind of arm.
        state: ``moving``, ``holds``, ``limp``, ``stopped``, or ``unreachable``.
        operator: The operator who controls the arm; empty if nobody does.
        stopped_for: The reason for a stop; empty if the arm is not stopped.
        temperature_c: The temperature of the hottest servo.
        alarms: The alarms of the servos.
        latency_s: Time from the request to the answer, including reading the servos.
        error: The reason why the machine cannot be reached.
    """

    host: str
    name: str = ""
    arm: str = ""
    state: str = "unreachable"
    operator: str = ""
    stopped_for: str = ""
    temperature_c: float | None = None
    alarms: tuple[str, ...] = ()
    latency_s: float | None = None
    error: str = ""


def read_fleet(hosts: Sequence[Endpoint]) -> list[FleetArm]:
    """Read the arms of several machines; an unreachable machine becomes a row with an error."""
    rows: list[FleetArm] = []
    for host, found in zip(hosts, on_each_host(list(hosts), _read_host), strict=True):
        if isinstance(found, IkservoError):
            rows.append(FleetArm(_place(host), error=found.message))
        else:
            rows += found
    return rows


def _place(host: Endpoint) -> str:
    return str(host).partition("/")[2]


def _read_host(host: Endpoint) -> list[FleetArm]:
    request = encode(ServiceRequest())
    rows: list[FleetArm] = []
    with open_client([host], client_certificate(host)) as session:
        for name in served_names(session, _TIMEOUT_S):
            before_s = time.monotonic()
            answers = ask(session, keys.watch(name, "health"), request, _TIMEOUT_S)
            rows.append(_row(host, name, answers, time.monotonic() - before_s))
    return rows


def _row(
    host: Endpoint, name: str, answers: Sequence[tuple[str, bytes]], latency_s: float
) -> FleetArm:
    if not answers:
        return FleetArm(_place(host), name, error="it does not answer")
    try:
        health = parse_result(ServedHealth, result_of(answers[0][1]))
        return FleetArm(
            host=_place(host),
            name=name,
            arm=health.arm,
            state=health.state,
            operator=health.operator,
            stopped_for=health.stop_text,
            temperature_c=health.temperature_c,
            alarms=tuple(health.alarms),
            latency_s=latency_s,
        )
    except IkservoError as error:
        return FleetArm(_place(host), name, error=error.message)

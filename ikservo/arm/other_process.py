"""Stop, query or relax an arm that another process controls."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from typing import TypeVar

from ikservo.arm.networks import find_network, installed_networks
from ikservo.arm.opening import open_bus, resolve_port
from ikservo.arm.result_json import decode_as
from ikservo.clock import Clock, RealClock
from ikservo.control.stop_requests import StopOutcome, hold_servos
from ikservo.errors import IkservoError, PortBusyError
from ikservo.guard import DrivenJoint
from ikservo.hardware.port_names import is_simulated
from ikservo.model import Model
from ikservo.model.load_lag import LoadLag, load_lags
from ikservo.planning.reports import ArmState, JointMoveResult
from ikservo.serving.control_client import (
    ControlCommand,
    StopAllResult,
    StopResult,
    request_stop,
    send_command,
)

T = TypeVar("T")

_RELAX_TIMEOUT_S = 120.0  # to lower an arm and switch its torque off
# A program reads all of its servos between opening a port and listening.
_START_TIMEOUT_S = 3.0
_RETRY_PERIOD_S = 0.02  # between two attempts meanwhile


def stop_arm(model: Model, port: str | None, clock: Clock | None = None) -> StopResult:
    """Stop an arm by a command to the program that has its port open, or else on the port itself.

    ``clock`` measures the wait for a program that does not listen yet.

    Raises:
        IkservoError: That program cannot stop the arm, or the port cannot be opened.
    """
    network_address = find_network(port)
    if network_address is not None:
        network, address = network_address
        return network.stop_arm(address)
    device = resolve_port(model, port)
    clock = clock or RealClock()
    until_s = clock.now_s() + _START_TIMEOUT_S
    while True:
        stopped = None if is_simulated(device) else request_stop(device, model.name)
        if stopped is not None:
            return stopped
        try:
            outcome = halt_line(model, port)
        except PortBusyError:  # a program that has just opened it does not listen yet
            if clock.now_s() > until_s:
                raise
            clock.sleep_until(clock.now_s() + _RETRY_PERIOD_S)
        else:
            held, limp, silent = outcome.held, outcome.limp, outcome.silent
            return StopResult(model.name, device, False, held, limp, silent, latched=False)


def stop_remote_arms() -> StopAllResult:
    """Stop the arm at the address in ``IKSERVO_PORT`` and the arms of listed machines."""
    with ThreadPoolExecutor() as pool:  # an arm without a reply must not delay the others
        return StopAllResult.joined(pool.map(_attempt, _remote_stops()))


def _remote_stops() -> Iterator[Callable[[], StopAllResult]]:
    """Yield the stop functions; the first one runs even if a later network fails to load."""
    own = find_network(None)
    if own is not None:
        network, address = own
        yield lambda: StopAllResult((network.stop_arm(address),))
    for each in installed_networks():
        yield each.stop_all_arms


def _attempt(stop: Callable[[], StopAllResult]) -> StopAllResult:
    try:
        return stop()
    except IkservoError as error:
        return StopAllResult(errors=(error,))


def query_state(model: Model, port: str | None) -> ArmState | None:
    """Request an arm's state from the program that has its port open; None if there is no program.

    An arm on another machine is opened over the network without taking control of it.

    Raises:
        IkservoError: That program cannot report the state.
    """
    return _request(ArmState, model, port, ControlCommand.WHERE, 10.0)


def request_relax(model: Model, port: str | None) -> JointMoveResult | None:
    """Let the program that has an arm's port open relax the arm; None if there is no program.

    Raises:
        IkservoError: That program cannot relax the arm.
    """
    return _request(JointMoveResult, model, port, ControlCommand.RELAX, _RELAX_TIMEOUT_S)


def _request(
    kind: type[T], model: Model, port: str | None, command: ControlCommand, timeout_s: float
) -> T | None:
    if find_network(port) is not None:
        return None
    device = resolve_port(model, port)
    simulated = is_simulated(device)
    reply = None if simulated else send_command(device, command, timeout_s, model.name)
    return None if reply is None else decode_as(kind, reply)


def halt_line(model: Model, port: str | None) -> StopOutcome:
    """Open the port of an arm that no program uses, and hold every joint with torque.

    Neither models nor calibration are checked, so that anything that moves is stopped.

    Raises:
        PortError: The port cannot be opened.
    """
    with open_bus(model, port) as bus:
        return hold_servos(bus, _nominal_limits(model), bus.port.clock)


def _nominal_limits(model: Model) -> list[DrivenJoint]:
    """Return servo limits from the arm file alone, with a top speed of 1 rad/s or 1 m/s."""
    lags = load_lags(model, model.chain, model.payload_kg)
    return [
        DrivenJoint(
            joint.joint_map,
            joint.limits,
            speed=1.0,
            lifting_lag_rad=lags.get(joint.name, LoadLag()).lifting_rad,
        )
        for joint in model.joints
    ]

"""Plug-ins that open arms on other machines by their address."""

from __future__ import annotations

from functools import cache
from importlib.metadata import entry_points
from typing import TYPE_CHECKING, Protocol, cast

from ikservo.arguments import parse_port
from ikservo.hardware.port_choice import named_port
from ikservo.hardware.transport import NETWORK_GROUP
from ikservo.model import Model

if TYPE_CHECKING:
    from ikservo.arguments import OnExit
    from ikservo.arm.arm_protocol import OpenArm
    from ikservo.serving.control_client import StopAllResult, StopResult


class ArmNetwork(Protocol):
    """Network of arms on other machines; entry points of ``NETWORK_GROUP`` name such an object."""

    def open_arm(self, model: Model, address: str, on_exit: OnExit) -> OpenArm:
        """Open the arm at an address.

        Raises:
            PortError: The arm cannot be reached.
        """
        ...

    def stop_arm(self, address: str) -> StopResult:
        """Stop the arm at an address, whoever controls it.

        Raises:
            PortError: The arm cannot be reached.
        """
        ...

    def stop_all_arms(self) -> StopAllResult:
        """Stop every arm on the machines that the user has listed."""
        ...


def find_network(port: object) -> tuple[ArmNetwork, str] | None:
    """Return the network and address of a port; None if the port is on this machine.

    If ``port`` is None, it is taken from ``IKSERVO_PORT``.

    Raises:
        BadValueError: The value is not the name of a port.
    """
    address = named_port(parse_port(port))
    network = _load(address.partition(":")[0]) if ":" in address else None
    return None if network is None else (network, address)


def installed_networks() -> list[ArmNetwork]:
    """Return all installed networks."""
    found = (_load(point.name) for point in entry_points(group=NETWORK_GROUP))
    return [network for network in found if network is not None]


@cache
def _load(scheme: str) -> ArmNetwork | None:
    for point in entry_points(group=NETWORK_GROUP, name=scheme):
        return cast("ArmNetwork", point.load())
    return None

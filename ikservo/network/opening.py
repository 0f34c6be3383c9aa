"""Open, stop and list arms on other machines by their address."""

from __future__ import annotations

import os
import socket
from typing import TYPE_CHECKING, Any, cast

from ikservo.arm import OnExit
from ikservo.arm.reports import StopResult
from ikservo.errors import IkservoError
from ikservo.model import Model
from ikservo.network import key_expressions as keys
from ikservo.network.address import ArmAddress, Endpoint, parse_address, parse_host
from ikservo.network.certificates import client_certificate
from ikservo.network.connection import Connection
from ikservo.network.fleet import on_each_host
from ikservo.network.messages import ServiceRequest, encode, result_of
from ikservo.network.remote_arm import RemoteArm
from ikservo.network.session import ask, open_client

if TYPE_CHECKING:
    from ikservo.arm import Arm

__all__ = ["NETWORK", "ZenohNetwork", "connect", "fleet_hosts"]

_VARIABLE = "IKSERVO_FLEET"
_PROBE_TIMEOUT_S = 0.3


def connect(address: ArmAddress) -> Connection:
    """Connect to a served arm.

    Raises:
        PortError: It cannot be reached, or refuses this user's certificate.
    """
    return Connection(address, client_certificate(address.endpoint))


class ZenohNetwork:
    """Arms behind ``zenoh:NAME@HOST``; see ``ArmNetwork``."""

    def open_arm(self, model: Model, address: str, on_exit: OnExit) -> Arm:
        """Open the arm at an address.

        Raises:
            BadValueError: It is no address.
            PortError: It cannot be reached, or no arm of that name is served there.
            InputError: The arm there has other joints than the model.
        """
        connection = connect(parse_address(address))
        try:
            return cast("Arm", RemoteArm(model, connection, on_exit))
        except BaseException:
            connection.close()
            raise

    def stop_arm(self, address: str) -> StopResult:
        """Stop the arm at an address, whoever controls it."""
        connection = connect(parse_address(address))
        try:
            stopped = connection.stop("", "CLIENT")
        finally:
            connection.close()
        return cast("StopResult", stopped)

    def stop_all_arms(self) -> list[StopResult]:
        """Stop every arm on the machines of ``IKSERVO_FLEET``, and those served on this one.

        Raises:
            IkservoError: One of them is no address or could not be reached; the others were
                stopped.
        """
        stopped: list[StopResult] = []
        hosts, errors = _machines_to_stop()
        for found in on_each_host(hosts, _stop_host):
            if isinstance(found, IkservoError):
                errors.append(found)
            else:
                stopped += found
        if errors:
            raise errors[0]
        return stopped


NETWORK = ZenohNetwork()


def fleet_hosts(given: tuple[str, ...] | list[str]) -> list[Endpoint]:
    """Return the machines that the user has named, else those of ``IKSERVO_FLEET``.

    Raises:
        BadValueError: One is no ``HOST[:PORT]``.
    """
    return [parse_host(host) for host in list(given) or _listed_hosts()]


def _listed_hosts() -> list[str]:
    return os.environ.get(_VARIABLE, "").replace(",", " ").split()


def _machines_to_stop() -> tuple[list[Endpoint], list[IkservoError]]:
    """Return all machines that can be asked to stop, and what is wrong with the others' names."""
    hosts: list[Endpoint] = []
    errors: list[IkservoError] = []
    for text in _listed_hosts():
        try:
            hosts.append(parse_host(text))
        except IkservoError as error:
            errors.append(error)
    own = parse_host("127.0.0.1")
    if own not in hosts and _listens(own):
        hosts.append(own)
    return hosts, errors


def _listens(endpoint: Endpoint) -> bool:
    """Return whether anything listens there; a session of Zenoh waits for seconds to know."""
    try:
        socket.create_connection((endpoint.host, endpoint.port), _PROBE_TIMEOUT_S).close()
    except OSError:
        return False
    return True


def _stop_host(host: Endpoint) -> list[StopResult]:
    return cast("list[StopResult]", [result for _, result in ask_host(host, keys.stop("*"))])


def ask_host(host: Endpoint, key: str) -> list[tuple[str, Any]]:
    """Send a request to every arm of a machine; return the arms' names and results.

    Raises:
        IkservoError: It cannot be reached, or an arm refused.
    """
    request = encode(ServiceRequest(schema="ikservo/net/1"))
    with open_client([host], client_certificate(host)) as session:
        return [
            (name.split("/")[1], result_of(data)) for name, data in ask(session, key, request, 5.0)
        ]

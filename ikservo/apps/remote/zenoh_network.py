"""Open, stop and list arms on other machines by their address."""

from __future__ import annotations

import os

from ikservo.apps.remote.address import ArmAddress, Endpoint, parse_address, parse_host
from ikservo.apps.remote.certificates import client_certificate
from ikservo.apps.remote.client_connection import Connection
from ikservo.apps.remote.remote_arm import RemoteArm
from ikservo.apps.remote.remote_stop import FLEET_VARIABLE, stop_address, stop_listed_machines
from ikservo.arm import OnExit, OpenArm
from ikservo.model import Model


def connect(address: ArmAddress) -> Connection:
    """Connect to a served arm.

    Raises:
        PortError: The arm cannot be reached, or refuses this user's certificate.
    """
    return Connection(address, client_certificate(address.endpoint))


class ZenohNetwork:
    """Arms behind ``zenoh:NAME@HOST``; see ``ArmNetwork``."""

    def open_arm(self, model: Model, address: str, on_exit: OnExit) -> OpenArm:
        """Open the arm at an address.

        Raises:
            BadValueError: The text is not an address.
            PortError: The arm cannot be reached, or no arm of that name is served there.
            InputError: The arm's joints differ from the model's.
        """
        connection = connect(parse_address(address))
        try:
            return RemoteArm(model, connection, on_exit)
        except BaseException:
            connection.close()
            raise

    stop_arm = staticmethod(stop_address)
    stop_all_arms = staticmethod(stop_listed_machines)


NETWORK = ZenohNetwork()


def fleet_hosts(given: tuple[str, ...] | list[str]) -> list[Endpoint]:
    """Return the machines that the user has named, or else those in ``IKSERVO_FLEET``.

    Raises:
        BadValueError: An entry is not ``HOST[:PORT]``.
    """
    listed = os.environ.get(FLEET_VARIABLE, "").replace(",", " ").split()
    return [parse_host(host) for host in list(given) or listed]

"""``ikservo stop``: stop the arm, whichever program moves it."""

from __future__ import annotations

from typing import Annotated

import typer

from ikservo.arm.networks import find_network
from ikservo.arm.other_process import stop_arm
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import ArmConnection, JsonOption
from ikservo.cli.quick_stop import report_stop, stop_every_arm
from ikservo.serving.control_client import StopAllResult

All = Annotated[
    bool,
    typer.Option(
        "--all", help="Stop every arm that your programs or the machines in IKSERVO_FLEET move."
    ),
]


def command(*, connection: ArmConnection, every: All = False, json: JsonOption = False) -> None:
    """Stop the arm where it is; torque does not change.

    With --all, or if neither options nor environment name an arm or a port, every arm that your
    programs move is stopped, including those at the address in IKSERVO_PORT and on the machines in
    IKSERVO_FLEET. If no program uses the port of the arm, this command opens it and makes every
    servo with torque hold its position.

    ikservo stop
    """
    if every or not (connection.arm or connection.port):
        found = stop_every_arm()
    else:
        network_address = find_network(connection.port)
        if network_address is None:
            one = stop_arm(model_from_option(connection.arm), connection.port)
        else:
            network, address = network_address  # the program at the address knows its arm
            one = network.stop_arm(address)
        found = StopAllResult((one,))
    raise typer.Exit(report_stop(found, as_json=json))

"""``ikservo ros``: make an arm a ROS 2 node, without ROS."""

from __future__ import annotations

import os
from typing import Annotated

import typer

from ikservo.apps.remote.address import Endpoint, parse_host
from ikservo.apps.remote.certificates import client_certificate
from ikservo.apps.remote.ros.bridge import INPUTS, OUTPUTS, SERVICES, RosBridge
from ikservo.apps.remote.ros.trajectory_action import ACTION
from ikservo.apps.remote.ros.wire import MAX_DOMAIN, check_namespace
from ikservo.apps.remote.serve_command import ended_by_signal
from ikservo.apps.remote.zenoh_session import open_router_client
from ikservo.arm import OpenArm
from ikservo.cli.open_and_confirm import open_from_options
from ikservo.cli.option_groups import Without
from ikservo.cli.options import MotionOptions, NamedArmConnection, SpeedOption
from ikservo.cli.terminal import format_port, print_json, print_status
from ikservo.cli.wiggle_prompt import check_directions_once
from ikservo.errors import BadValueError, shown

_ROUTER_PORT = 7447
_DOMAIN_VARIABLE = "ROS_DOMAIN_ID"

Domain = Annotated[
    int | None,
    typer.Option(
        "--domain", min=0, max=MAX_DOMAIN, help="ROS 2 domain; default: ROS_DOMAIN_ID, or 0."
    ),
]
Router = Annotated[
    str, typer.Option("--router", metavar="ENDPOINT", help="Endpoint of rmw_zenohd.")
]
Namespace = Annotated[
    str, typer.Option("--namespace", help="Prefix of all topic and service names, such as left.")
]
Rate = Annotated[
    float,
    typer.Option("--rate", min=0.1, max=200.0, help="Number of joint states published per second."),
]


def command(
    connection: NamedArmConnection,
    *,
    domain: Domain = None,
    router: Router = "tcp/127.0.0.1:7447",
    namespace: Namespace = "",
    rate: Rate = 50.0,
    speed: SpeedOption = "normal",
    options: Annotated[MotionOptions, Without("dry_run", "tip")],
) -> None:
    """Make an arm a ROS 2 node until Ctrl-C; only the other machine needs ROS, with rmw_zenoh.

    Everyone in its ROS domain can move the arm within its limits; see docs/how-to/ros2.md.

    ikservo ros so101

    ros2 topic echo /joint_states           where RMW_IMPLEMENTATION=rmw_zenoh_cpp
    """
    text = router if "/" in router else f"tcp/{router}"
    if not text.rpartition(":")[2].isdecimal():
        text += f":{_ROUTER_PORT}"
    endpoint, place = parse_host(text), check_namespace(namespace)
    if domain is None:
        text = os.environ.get(_DOMAIN_VARIABLE, "").strip() or "0"
        if not text.isdecimal() or int(text) > MAX_DOMAIN:
            raise BadValueError(_DOMAIN_VARIABLE, shown(text), f"a number from 0 to {MAX_DOMAIN}")
        domain = int(text)
    with (
        open_router_client(endpoint, client_certificate(endpoint)) as session,
        open_from_options(connection, options) as machine,
    ):
        check_directions_once(machine, options)
        bridge = RosBridge(session, machine, domain, place, rate, speed, print_status)
        with ended_by_signal() as wait, bridge:
            _announce(machine, endpoint, domain, place, json=options.json)
            wait()


def _announce(
    machine: OpenArm, router: Endpoint, domain: int, namespace: str, *, json: bool
) -> None:
    """Print the topics, services and actions of the node."""
    outputs, inputs = ([f"{namespace}{topic.name}" for topic in each] for each in (OUTPUTS, INPUTS))
    services = [f"{namespace}{name}" for name in SERVICES]
    actions = [f"{namespace}{ACTION}"]
    port = format_port(machine.port_name)
    if json:
        print_json(
            "ros", arm=machine.model.name, port=port, router=str(router), domain=domain,
            outputs=outputs, inputs=inputs, services=services, actions=actions,
        )  # fmt: skip
        return
    print_status(
        f"{machine.model.title} on {port} is in ROS 2 domain {domain}, via the router at "
        f"{router}; press Ctrl-C to end."
    )
    print_status(f"publishes   {' '.join(outputs)}")
    print_status(f"subscribes  {' '.join(inputs)}")
    print_status(f"services    {' '.join(services)}")
    print_status(f"actions     {' '.join(actions)}")

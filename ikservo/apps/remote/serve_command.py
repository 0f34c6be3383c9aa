"""``ikservo serve``: serve an arm to programs on other machines."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Generator
from contextlib import contextmanager
from types import FrameType
from typing import Annotated

import typer

from ikservo.apps.remote.address import ArmAddress, check_arm_name, parse_listen
from ikservo.apps.remote.arm_server import ArmServer
from ikservo.apps.remote.certificates import access_control, server_certificate
from ikservo.apps.remote.zenoh_session import open_server
from ikservo.arm import Arm
from ikservo.arm.networks import find_network
from ikservo.arm.opening import open_own_arm
from ikservo.cli.model_options import model_from_option
from ikservo.cli.option_groups import Without
from ikservo.cli.options import MotionOptions, NamedServoConnection, SceneOption
from ikservo.cli.terminal import format_port, print_json, print_status
from ikservo.cli.wiggle_prompt import check_directions_once
from ikservo.errors import InputError
from ikservo.model.scene_file import with_scene

Listen = Annotated[
    str,
    typer.Option(
        "--listen",
        metavar="ENDPOINT",
        help="tcp/127.0.0.1:7448 for this machine, tls/0.0.0.0:7448 for others.",
    ),
]
Name = Annotated[
    str | None, typer.Option("--name", help="Name in the address; default: the name of the arm.")
]
Rate = Annotated[
    float, typer.Option("--rate", min=0.1, max=200.0, help="Number of states published per second.")
]


def command(
    connection: NamedServoConnection,
    *,
    listen: Listen = "tcp/127.0.0.1:7448",
    name: Name = None,
    rate: Rate = 50.0,
    scene: SceneOption = None,
    options: Annotated[MotionOptions, Without("dry_run", "tip")],
) -> None:
    """Serve an arm to programs on other machines until Ctrl-C; see docs/network.md.

    Limits, collision checks and the dead-man timeout run here, on the machine with the arm.

    ikservo serve so101                     this machine: --port zenoh:so101@127.0.0.1

    ikservo serve so101 --name desk --listen tls/0.0.0.0:7448
    """
    endpoint = parse_listen(listen)
    model = model_from_option(connection.arm)
    if scene is not None:
        model = with_scene(model, scene)
    served_as = check_arm_name(name or model.name)
    certificate = server_certificate(endpoint)
    if find_network(connection.port) is not None:
        hint = "Run `ikservo serve` on the machine with the arm."
        raise InputError("An arm on another machine cannot be served again.", hint)
    access = None if certificate is None else access_control(served_as)
    with (
        open_server(endpoint, certificate, access) as session,
        open_own_arm(
            model, connection.port, collisions=options.collision, uncalibrated=options.uncalibrated
        ) as machine,
    ):
        check_directions_once(machine, options)
        with ended_by_signal() as wait, ArmServer(session, machine, served_as, rate):
            _announce(machine, ArmAddress(served_as, endpoint), json=options.json)
            wait()


def _announce(machine: Arm, address: ArmAddress, *, json: bool) -> None:
    """Print the address at which the arm is served."""
    if json:
        print_json(
            "serve",
            arm=machine.model.name,
            port=format_port(machine.port_name),
            endpoint=str(address.endpoint),
            address=str(address.from_other_machines()),
        )
        return
    print_status(
        f"{machine.model.title} on {format_port(machine.port_name)} is served at "
        f"{address.endpoint}; press Ctrl-C to end."
    )
    print_status(f"From the other machine: --port {address.from_other_machines()}")


@contextmanager
def ended_by_signal() -> Generator[Callable[[], None]]:
    """End the command without an error on Ctrl-C, SIGTERM and SIGHUP.

    Yields:
        A function that waits for a signal; signals since the start of the block count.
    """
    ended = threading.Event()

    def end(_: int, __: FrameType | None) -> None:
        ended.set()

    def wait() -> None:
        while not ended.wait(0.5):
            pass

    names = ("SIGINT", "SIGTERM", "SIGHUP")  # SIGHUP: the terminal was closed; not on Windows
    numbers = [getattr(signal, name) for name in names if hasattr(signal, name)]
    before = {number: signal.signal(number, end) for number in numbers}
    try:
        yield wait
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)

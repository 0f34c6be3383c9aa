"""``ikservo stop``: stop the arm, whatever program moves it."""

from __future__ import annotations

from typing import Annotated

import typer

from ikservo.arm.networks import find_network
from ikservo.arm.remote import StopResult, stop_all_arms, stop_arm
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import ArmOption, JsonOption, PortOption
from ikservo.cli.terminal import format_port, print_json, print_lines
from ikservo.errors import ExitCode, InputError

__all__ = ["command"]


All = Annotated[
    bool, typer.Option("--all", help="Every arm of your programs and of IKSERVO_FLEET.")
]


def command(
    *,
    arm: ArmOption = None,
    port: PortOption = None,
    every: All = False,
    json: JsonOption = False,
) -> None:
    """Stop the arm where it is; torque stays as it is.

    With --all, or where no arm and no port is given or in the environment, every arm that a
    program of yours moves is stopped, those at the address in IKSERVO_PORT and on the machines of
    IKSERVO_FLEET included. Where no program has the port of one arm, this one opens it and tells
    every servo with torque to stay where it is.

    ikservo stop
    """
    one = not every and bool(arm or port)
    stopped = [_stop_one(arm, port)] if one else stop_all_arms()
    if not stopped:
        raise InputError("No running ikservo program.", "Use --arm to stop the servos directly.")
    if json:
        print_json("stop", arms=stopped)
    else:
        print_lines((line for one in stopped for line in _stop_lines(one)), indent=12)
    if any(one.silent for one in stopped):
        raise typer.Exit(ExitCode.SILENT)


def _stop_one(arm: str | None, port: str | None) -> StopResult:
    """Stop one arm; at an address it is known which."""
    elsewhere = find_network(port)
    if elsewhere is not None:
        return elsewhere[0].stop_arm(elsewhere[1])
    return stop_arm(model_from_option(arm), port)


def _stop_lines(one: StopResult) -> list[str]:
    was = "was moving; stopped" if one.moving else "was not moving"
    rows = {"torque on": one.held, "torque off": one.limp, "no answer": one.silent}
    return [
        f"{one.arm} on {format_port(one.port)} {was}",
        *(f"{label:10}  {', '.join(names)}" for label, names in rows.items() if names),
    ]

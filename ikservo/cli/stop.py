"""``ikservo stop``: stop the arm, whatever program moves it."""

from __future__ import annotations

from typing import Annotated

import typer

from ikservo.arm.networks import find_network
from ikservo.arm.remote import StopAllResult, StopResult, stop_all_arms, stop_arm
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import ArmOption, JsonOption, PortOption
from ikservo.cli.terminal import format_port, print_json, print_lines, print_status
from ikservo.errors import ExitCode, IkservoError, InputError

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
    found = StopAllResult((_stop_one(arm, port),)) if one else stop_all_arms()
    if not (found.stopped or found.errors):
        raise InputError(
            "No program of yours has an arm open, and none is served on this machine.",
            "To stop the servos of one directly: ikservo stop --arm NAME",
        )
    if json:
        print_json("stop", arms=found.stopped, errors=[_error_fields(e) for e in found.errors])
    else:
        _print_outcome(found)
    _exit_by(found)


def _print_outcome(found: StopAllResult) -> None:
    print_lines((line for one in found.stopped for line in _stop_lines(one)), indent=12)
    for error in found.errors:
        print_status(f"Not confirmed to be stopped: {error.command_message}")
        print_status(error.command_hint)


def _error_fields(error: IkservoError) -> dict[str, object]:
    return {
        "error": error.command_message,
        "hint": error.command_hint,
        "exit_code": int(error.exit_code),
    }


def _exit_by(found: StopAllResult) -> None:
    """End the command with the code of what was not stopped.

    Raises:
        Exit: Something was not.
    """
    for error in found.errors:
        raise typer.Exit(error.exit_code)
    if any(one.silent for one in found.stopped):
        raise typer.Exit(ExitCode.SILENT)


def _stop_one(arm: str | None, port: str | None) -> StopResult:
    """Stop one arm; at an address it is known which."""
    elsewhere = find_network(port)
    if elsewhere is not None:
        return elsewhere[0].stop_arm(elsewhere[1])
    return stop_arm(model_from_option(arm), port)


def _stop_lines(one: StopResult) -> list[str]:
    was = "was moving; stopped" if one.moving else "was not moving"
    was += "; moves again once that is acknowledged" if one.latched else ""
    rows = {"torque on": one.held, "torque off": one.limp, "no answer": one.silent}
    return [
        f"{one.arm} on {format_port(one.port)} {was}",
        *(f"{label:10}  {', '.join(names)}" for label, names in rows.items() if names),
    ]

"""``ikservo stop``: stop the arm, whatever program moves it."""

from __future__ import annotations

import typer

from ikservo.arm.remote import StopResult, stop_all_arms, stop_arm
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import ArmOption, JsonOption, PortOption
from ikservo.cli.terminal import format_port, print_json, print_lines
from ikservo.errors import ExitCode, InputError

__all__ = ["command"]


def command(*, arm: ArmOption = None, port: PortOption = None, json: JsonOption = False) -> None:
    """Stop the arm where it is; torque stays as it is.

    Without --arm every arm that a program of yours moves is stopped. Where no program has the port,
    this one opens it and tells every servo with torque to stay where it is.

    ikservo stop
    """
    stopped = [stop_arm(model_from_option(arm), port)] if arm or port else stop_all_arms()
    if not stopped:
        raise InputError("No running ikservo program.", "Use --arm to stop the servos directly.")
    if json:
        print_json("stop", arms=stopped)
    else:
        print_lines((line for one in stopped for line in _stop_lines(one)), indent=12)
    if any(one.silent for one in stopped):
        raise typer.Exit(ExitCode.SILENT)


def _stop_lines(one: StopResult) -> list[str]:
    was = "was moving; stopped" if one.moving else "was not moving"
    rows = {"torque on": one.held, "torque off": one.limp, "no answer": one.silent}
    return [
        f"{one.arm} on {format_port(one.port)} {was}",
        *(f"{label:10}  {', '.join(names)}" for label, names in rows.items() if names),
    ]

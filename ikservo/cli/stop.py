"""``ikservo stop``: whatever moves the arm, it holds now."""

from __future__ import annotations

import typer

from ikservo.arm.owner.elsewhere import Stopped, stop_all, stop_from_here
from ikservo.cli.choosing import chosen_model
from ikservo.cli.options import ArmOption, JsonOption, PortOption
from ikservo.cli.output import port_words, print_json, print_lines
from ikservo.errors import ExitCode, InputError

__all__ = ["command"]


def command(*, arm: ArmOption = None, port: PortOption = None, json: JsonOption = False) -> None:
    """Stop the arm where it is; torque stays as it is.

    Without --arm every arm that a program of yours moves is stopped. Where no program has the port,
    this one opens it and tells every servo with torque to stay where it is.

    ikservo stop
    """
    stopped = [stop_from_here(chosen_model(arm), port)] if arm or port else stop_all()
    if not stopped:
        raise InputError("No running ikservo program.", "Use --arm to stop the servos directly.")
    if json:
        print_json("stop", arms=stopped)
    else:
        print_lines((line for one in stopped for line in _lines(one)), indent=12)
    if any(one.silent for one in stopped):
        raise typer.Exit(ExitCode.SILENT)


def _lines(one: Stopped) -> list[str]:
    was = "was moving; stopped" if one.moving else "was not moving"
    rows = {"torque on": one.held, "torque off": one.limp, "no answer": one.silent}
    return [
        f"{one.arm} on {port_words(one.port)} {was}",
        *(f"{word:10}  {', '.join(names)}" for word, names in rows.items() if names),
    ]

"""``ikservo recover``: alarms are cleared by each family's own way."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from ikservo.arm.care.recovery import Recovery, recover
from ikservo.arm.line import open_line
from ikservo.cli.choosing import chosen_model
from ikservo.cli.options import ArmOption, JsonOption, PortOption
from ikservo.cli.output import note, print_json, print_table
from ikservo.cli.prompts import confirm
from ikservo.errors import ExitCode, IkservoError, InputError

__all__ = ["command"]

Reboot = Annotated[
    bool, typer.Option("--reboot", help="Restart servos that need it; their torque goes off.")
]
Yes = Annotated[bool, typer.Option("--yes", "-y", help="Do not ask before torque goes off.")]


def command(
    *,
    arm: ArmOption = None,
    port: PortOption = None,
    reboot: Reboot = False,
    yes: Yes = False,
    json: JsonOption = False,
) -> None:
    """Clear overload and other alarms; each goal becomes the joint's position.

    ikservo recover --arm so101

    ikservo recover --arm koch --reboot        torque is off while Dynamixels restart
    """
    model = chosen_model(arm)
    with open_line(model, port) as bus:
        if reboot and not yes:
            _ask(bus.port.name)
        done = recover(bus, reboot=reboot)
    _print(done, json=json)
    if any(one.torque is None for one in done):
        raise typer.Exit(ExitCode.SILENT)
    if not all(one.well for one in done):
        raise typer.Exit(ExitCode.ALARM)


def _ask(port: str) -> None:
    if port.startswith("sim:"):
        return
    if not sys.stdin.isatty():
        raise InputError(
            "Cannot ask: input is not a terminal.",
            "To restart servos without being asked, add --yes.",
        )
    if not confirm("Torque goes off while servos restart. Is the arm supported?"):
        raise IkservoError("Cancelled; nothing was restarted.", "Without asking: --yes")


def _print(done: list[Recovery], *, json: bool) -> None:
    if json:
        print_json("recover", servos=[_facts(one) for one in done])
        return
    columns = ["joint", "id", "alarms before", "done", "alarms now", "torque"]
    print_table(columns, [_row(one) for one in done])
    left = [str(one.servo) for one in done if not one.well]
    note(
        f"Still faulty: {', '.join(left)}."
        if left
        else "All servos are fine; each goal is its position."
    )


def _row(one: Recovery) -> list[str]:
    return [
        one.servo.name,
        str(one.servo.id),
        ", ".join(one.before) or "none",
        one.action,
        ", ".join(one.after) or "none",
        _torque(one),
    ]


def _torque(one: Recovery) -> str:
    return "unknown" if one.torque is None else "on" if one.torque else "off"


def _facts(one: Recovery) -> dict[str, object]:
    return {
        "joint": one.servo.name,
        "id": one.servo.id,
        "before": one.before,
        "after": one.after,
        "action": one.action,
        "torque": one.torque,
    }

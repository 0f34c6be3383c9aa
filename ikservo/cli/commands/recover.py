"""``ikservo recover``: clear alarms with the procedure of each servo family."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from ikservo.arm.opening import open_bus
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import JsonOption, ServoConnection
from ikservo.cli.results import Field, Fields, print_records
from ikservo.cli.terminal import confirm, print_status
from ikservo.errors import ExitCode, IkservoError, InputError
from ikservo.maintenance.alarm_recovery import RecoveryResult, recover

Reboot = Annotated[
    bool, typer.Option("--reboot", help="Restart the servos that need it; their torque goes off.")
]
Yes = Annotated[bool, typer.Option("--yes", "-y", help="Do not ask before torque goes off.")]


def command(
    *,
    connection: ServoConnection,
    reboot: Reboot = False,
    yes: Yes = False,
    json: JsonOption = False,
) -> None:
    """Clear overload and other alarms; joints with torque hold where they are.

    ikservo recover --arm so101

    ikservo recover --arm koch --reboot        torque is off while Dynamixels restart
    """
    model = model_from_option(connection.arm)
    with open_bus(model, connection.port) as bus:
        if reboot and not yes and not bus.port.name.startswith("sim:"):
            if not sys.stdin.isatty():
                hint = "To restart servos without being asked, add --yes."
                raise InputError("Cannot ask: input is not a terminal.", hint)
            if not confirm("Torque goes off while the servos restart. Is the arm supported?"):
                raise IkservoError(
                    "Cancelled; nothing was restarted.", "To go on without being asked, add --yes."
                )
        done = recover(bus, reboot=reboot)
    _print_recoveries(done, json=json)
    if any(one.torque is None for one in done):
        raise typer.Exit(ExitCode.SILENT)
    if not all(one.healthy for one in done):
        raise typer.Exit(ExitCode.ALARM)


_FIELDS: Fields[RecoveryResult] = (
    Field("joint", "joint", value=lambda one: one.servo.name),
    Field("id", "id", value=lambda one: one.servo.id),
    Field("before", "alarms before", lambda one: list(one.before) or "none"),
    Field("after", "alarms now", lambda one: list(one.after) or "none"),
    Field("action", "done"),
    Field(
        "torque",
        "torque",
        lambda one: "unknown" if one.torque is None else "on" if one.torque else "off",
    ),
)
_COLUMNS = "joint id before action after torque"


def _print_recoveries(done: list[RecoveryResult], *, json: bool) -> None:
    print_records("recover", "servos", done, _FIELDS, json=json, order=_COLUMNS)
    if json:
        return
    left = [str(one.servo) for one in done if not one.healthy]
    if left:
        print_status(f"Still faulty: {', '.join(left)}.")
        return
    print_status("No servo reports an alarm.")
    limp = [one.servo.name for one in done if not one.torque]
    if not limp:
        print_status("Torque is on: every joint holds where it is.")
    elif len(limp) == len(done):
        print_status("Torque is off: the arm is limp. The next motion switches it on.")
    else:
        print_status(f"Torque is off at {', '.join(limp)}. The other joints hold.")

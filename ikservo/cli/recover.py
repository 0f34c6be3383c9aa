"""``ikservo recover``: clear alarms with the procedure of each servo family."""

from __future__ import annotations

import sys
from typing import Annotated

import typer

from ikservo.arm.opening import open_bus
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import JsonOption, ServoConnection
from ikservo.cli.terminal import confirm, print_json, print_status, print_table
from ikservo.errors import ExitCode, IkservoError, InputError
from ikservo.maintenance.recovery import RecoveryResult, recover

__all__ = ["command"]

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
        if reboot and not yes:
            _confirm_recovery(bus.port.name)
        done = recover(bus, reboot=reboot)
    _print_recoveries(done, json=json)
    if any(one.torque is None for one in done):
        raise typer.Exit(ExitCode.SILENT)
    if not all(one.healthy for one in done):
        raise typer.Exit(ExitCode.ALARM)


def _confirm_recovery(port: str) -> None:
    if port.startswith("sim:"):
        return
    if not sys.stdin.isatty():
        raise InputError(
            "Cannot ask: input is not a terminal.",
            "To restart servos without being asked, add --yes.",
        )
    if not confirm("Torque goes off while servos restart. Is the arm supported?"):
        raise IkservoError("Cancelled; nothing was restarted.", "Without asking: --yes")


def _print_recoveries(done: list[RecoveryResult], *, json: bool) -> None:
    if json:
        print_json("recover", servos=[_recovery_fields(one) for one in done])
        return
    columns = ["joint", "id", "alarms before", "done", "alarms now", "torque"]
    print_table(columns, [_format_recovery_row(one) for one in done])
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
        print_status(f"Torque is off, limp: {', '.join(limp)}. The other joints hold.")


def _format_recovery_row(one: RecoveryResult) -> list[str]:
    return [
        one.servo.name,
        str(one.servo.id),
        ", ".join(one.before) or "none",
        one.action,
        ", ".join(one.after) or "none",
        _format_torque(one),
    ]


def _format_torque(one: RecoveryResult) -> str:
    return "unknown" if one.torque is None else "on" if one.torque else "off"


def _recovery_fields(one: RecoveryResult) -> dict[str, object]:
    return {
        "joint": one.servo.name,
        "id": one.servo.id,
        "before": one.before,
        "after": one.after,
        "action": one.action,
        "torque": one.torque,
    }

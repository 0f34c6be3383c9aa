"""``ikservo setup``: set ids and baud rates, one servo at a time, or restore an EEPROM backup."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from ikservo.apps.workbench.commissioning import (
    ConfiguredServo,
    configure_servos,
    open_line,
    remaining_settings,
)
from ikservo.apps.workbench.eeprom_restore import plan_restoration
from ikservo.apps.workbench.servo_command import OtherModel, restore_backup
from ikservo.apps.workbench.servo_workbench import open_servos
from ikservo.cli.options import JsonOption, ServoPortOption
from ikservo.cli.quantities import parse_time_s
from ikservo.cli.terminal import print_json, print_lines, print_status
from ikservo.cli.terminal_dialogue import Operator
from ikservo.control.stop_requests import exiting_on_signals
from ikservo.errors import IkservoError, InputError
from ikservo.hardware.eeprom import read_backup
from ikservo.model import load_model

ArmName = Annotated[
    str | None,
    typer.Argument(
        metavar="ARM", envvar="IKSERVO_ARM", help="A name from `ikservo arms`, or a file."
    ),
]
Start = Annotated[str | None, typer.Option("--start", help="Continue from this joint.")]
Wait = Annotated[
    float,
    typer.Option(
        "--wait",
        parser=parse_time_s,
        help="Time to wait for each servo; default: 5min.",
        show_default=False,
    ),
]
Yes = Annotated[bool, typer.Option("--yes", "-y", help="Do not ask before a servo is written.")]


@dataclass(frozen=True, kw_only=True)
class RestoreOptions:
    """The EEPROM backup to restore, and its servo."""

    restore: Annotated[
        Path | None,
        typer.Option(
            "--restore",
            metavar="FILE",
            help="Write this EEPROM backup to the servo that it came from.",
        ),
    ] = None
    servo: Annotated[
        str | None,
        typer.Option(
            "--servo",
            metavar="JOINT",
            help="Restore to this servo (joint or id), even if its id differs.",
        ),
    ] = None
    other_model: OtherModel = False


def command(
    arm: ArmName = None,
    *,
    port: ServoPortOption = None,
    start: Start = None,
    wait: Wait = 300.0,
    backup: RestoreOptions,
    yes: Yes = False,
    json: JsonOption = False,
) -> None:
    """Give each servo of an arm its id and baud rate; nothing moves.

    Plug in one servo at a time when you are asked; it is found at any baud rate.

    ikservo setup so101

    ikservo setup so101 --start elbow_flex        continue where you stopped

    ikservo setup so101 --restore FILE            write an EEPROM backup to its servo
    """
    if not arm:
        raise InputError("Missing argument 'ARM'.", "Name the arm, as in: ikservo setup so101")
    model = load_model(arm)
    if not model.joints:
        raise InputError(f"{model.path} names no servos.", "A real arm needs an arm.toml.")
    if backup.restore:
        copy = read_backup(backup.restore)
        with open_servos(model, port) as line:
            plan = plan_restoration(line.bus, copy, backup.servo, other_model=backup.other_model)
            restore_backup(line, plan, yes=yes, json=json)
        return
    if backup != RestoreOptions():
        raise InputError("--servo and --other-model need --restore.", "Add --restore FILE.")
    operator = Operator.of(None, yes=yes)
    todo = remaining_settings(model, start)
    done: list[ConfiguredServo] = []

    def report(configured: ConfiguredServo) -> None:
        done.append(configured)
        _print_configured(configured, json=json)

    with exiting_on_signals(), open_line(model, port) as line:
        try:
            operator.run(configure_servos(line, model, todo, wait, report))
        except (IkservoError, KeyboardInterrupt, SystemExit, typer.Abort):
            if len(done) < len(todo):
                joint = todo[len(done)].servo.name
                print_status(f"Continue with: ikservo setup {arm} --start {joint}")
            raise
    print_status(
        f"All servos are set up. Connect them to each other, then run: ikservo doctor --arm {arm}"
    )


def _print_configured(configured: ConfiguredServo, *, json: bool) -> None:
    if not json:
        print_lines([str(configured)])
        return
    print_json(
        "setup",
        joint=configured.servo.name,
        id=configured.servo.id,
        model=configured.servo.table.model_name,
        was_id=configured.found.id,
        was_baud_rate=configured.found.baud_rate,
        written=configured.written,
    )

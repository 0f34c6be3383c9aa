"""``ikservo setup``: set ids and baud rates, one servo at a time, or restore an EEPROM backup."""

from __future__ import annotations

import sys
from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from ikservo.arm.opening import open_bus
from ikservo.cli.options import JsonOption, ServoPortOption, parse_time_s
from ikservo.cli.terminal import confirm, print_json, print_lines, print_status
from ikservo.errors import IkservoError, InputError
from ikservo.hardware.eeprom import read_backup
from ikservo.hardware.provisioning import ServoSettings
from ikservo.hardware.scan import FoundServo
from ikservo.maintenance.arm_sketch import ascii_sketch
from ikservo.maintenance.commissioning import ConfiguredServo, commission, planned_settings
from ikservo.maintenance.eeprom_restore import Restoration, plan_restoration, restore
from ikservo.model import Model, load_model

__all__ = ["command"]

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
Restore = Annotated[
    Path | None,
    typer.Option("--restore", metavar="FILE", help="Write this EEPROM backup to its servo."),
]
Servo = Annotated[
    str | None,
    typer.Option(
        "--servo",
        metavar="JOINT",
        help="Restore to this servo (joint or id), even if its id differs.",
    ),
]
OtherModel = Annotated[
    bool, typer.Option("--other-model", help="Restore a backup of another servo model.")
]
Yes = Annotated[bool, typer.Option("--yes", "-y", help="Do not ask before a servo is written.")]


def _restore_backup(
    model: Model,
    port: str | None,
    path: Path,
    *,
    target: str | None,
    other_model: bool,
    yes: bool,
    json: bool,
) -> None:
    """Write an EEPROM backup to its servo, after confirmation."""
    backup = read_backup(path)
    with open_bus(model, port) as bus:
        plan = plan_restoration(bus, backup, target, other_model=other_model)
        _print_restoration(plan)
        if plan.changes and not (yes or _confirm_restoration(plan)):
            raise IkservoError("Cancelled; the servo was not changed.")
        restore(bus, plan)
    written = [
        _format_change(each.register.name, each.found, each.expected) for each in plan.changes
    ]
    if json:
        _print_json(plan, written)
    else:
        print_lines([f"✓ {plan.servo}: {', '.join(written) or 'nothing to change'}"])
    if written:
        print_status(
            "A calibration may depend on the changed values. Check the arm: ikservo doctor"
        )


def _print_restoration(plan: Restoration) -> None:
    count = len(plan.changes)
    print_status(f"{plan.servo}: {count or 'no'} register{'s' * (count != 1)} to restore.")
    for each in plan.changes:
        print_status(f"    {_format_change(each.register.name, each.found, each.expected)}")
    for each in plan.kept:
        print_status(f"    {each.register} stays {each.found}; the backup has {each.expected}")


def _format_change(register: str, found: int, wanted: int) -> str:
    return f"{register} {found} → {wanted}"


def _confirm_restoration(plan: Restoration) -> bool:
    question = f"Write these to {plan.servo}?"
    if not sys.stdin.isatty():
        raise InputError(f"{question} Cannot ask: input is not a terminal.", "Give --yes.")
    return confirm(question)


def _print_json(plan: Restoration, written: list[str]) -> None:
    print_json(
        "setup",
        joint=plan.servo.name,
        id=plan.servo.id,
        model=plan.servo.table.model_name,
        backup=str(plan.backup.path),
        written=written,
        kept=[each.register.name for each in plan.kept],
    )


def command(
    arm: ArmName = None,
    *,
    port: ServoPortOption = None,
    start: Start = None,
    wait: Wait = 300.0,
    restore: Restore = None,
    servo: Servo = None,
    other_model: OtherModel = False,
    yes: Yes = False,
    json: JsonOption = False,
) -> None:
    """Give each servo of an arm its id and baud rate; nothing moves.

    Plug in one servo at a time, as you are asked; it is found at any baud rate.

    ikservo setup so101

    ikservo setup so101 --start elbow_flex        continue where you stopped

    ikservo setup so101 --restore FILE            write an EEPROM backup to its servo
    """
    if not arm:
        raise InputError("Missing argument 'ARM'.", "Name it, as in: ikservo setup so101")
    model = load_model(arm)
    if not model.joints:
        raise InputError(f"{model.path} names no servos.", "An arm that moves needs an arm.toml.")
    if restore:
        _restore_backup(
            model, port, restore, target=servo, other_model=other_model, yes=yes, json=json
        )
        return
    if servo or other_model:
        raise InputError("--servo and --other-model belong to --restore.", "Add --restore FILE.")
    helper = _ConsolePrompt(model, yes=yes, json=json)
    with _print_resume_hint(arm, helper):
        commission(model, port, helper, start=start, wait_s=wait)
    print_status(f"All servos are set up. Plug them together, then: ikservo doctor --arm {arm}")


class _ConsolePrompt:
    """Asks the user on stderr, and prints results on stdout."""

    def __init__(self, model: Model, *, yes: bool, json: bool) -> None:
        self._model, self._yes, self._json = model, yes, json
        self.joint: str | None = None
        self._status = _StatusLine()

    def request_servo(self, settings: ServoSettings) -> None:
        self.joint = settings.servo.name
        numbers = [w.servo.id for w in planned_settings(self._model)]
        count = numbers.index(settings.servo.id) + 1
        print_status("")
        for line in ascii_sketch(self._model, settings.servo.name):
            print_status(f"    {line}")
        print_status(
            f"{count} of {len(numbers)}: plug in only the {settings.servo.table.model_name} "
            f"of {settings.servo} …"
        )
        print_status(
            "Searching for it at every baud rate; Ctrl-C stops, servos already set up stay so."
        )

    def show_search(self, baud_rate: int) -> None:
        self._status.show(f"searching at {baud_rate} baud")

    def stop_searching(self) -> None:
        self._status.clear()

    def show_found(self, found: Sequence[FoundServo]) -> None:
        self._status.clear()
        if len(found) > 1 or any(servo.shares_id for servo in found):
            listed = "; ".join(map(str, found))
            print_status(f"More than one servo answers: {listed}. Leave only that of {self.joint}.")

    def confirm_write(self, settings: ServoSettings, found: FoundServo) -> bool:
        self._status.clear()
        print_status(f"Found {found}, firmware {found.firmware}.")
        if self._yes or (found.id, found.baud_rate) == (settings.servo.id, settings.baud_rate):
            return True
        question = (
            f"Make it id {settings.servo.id} at {settings.baud_rate} baud, {settings.servo.name}?"
        )
        if not sys.stdin.isatty():
            raise InputError(f"{question} Cannot ask: input is not a terminal.", "Give --yes.")
        return confirm(question)

    def report(self, configured: ConfiguredServo, *, last: bool) -> None:
        changes = ", ".join(configured.written) or "nothing to change"
        if self._json:
            _print_settled_json(configured)
        else:
            print_lines([f"✓ {configured.servo}: {changes}"])
        if not last:
            self.joint = self._next_instruction(configured)
            print_status("Unplug it.")

    def _next_instruction(self, configured: ConfiguredServo) -> str:
        todo = [settings.servo for settings in planned_settings(self._model)]
        return todo[todo.index(configured.servo) + 1].name


class _StatusLine:
    """A line on a terminal that is overwritten; prints nothing elsewhere."""

    def __init__(self) -> None:
        self._shown = False

    def show(self, text: str) -> None:
        if sys.stderr.isatty():
            self._shown = True
            print(f"\r\x1b[2K{text} …", end="", file=sys.stderr, flush=True)  # noqa: T201

    def clear(self) -> None:
        if self._shown:
            self._shown = False
            print("\r\x1b[2K", end="", file=sys.stderr, flush=True)  # noqa: T201


def _print_settled_json(configured: ConfiguredServo) -> None:
    print_json(
        "setup",
        joint=configured.servo.name,
        id=configured.servo.id,
        model=configured.servo.table.model_name,
        was_id=configured.found.id,
        was_baud_rate=configured.found.baud_rate,
        written=configured.written,
    )


@contextmanager
def _print_resume_hint(arm: str, helper: _ConsolePrompt) -> Generator[None]:
    """Print how to continue if the setup is interrupted."""
    try:
        yield
    except (IkservoError, KeyboardInterrupt, typer.Abort):
        helper.stop_searching()
        if helper.joint:
            print_status(f"Continue with: ikservo setup {arm} --start {helper.joint}")
        raise

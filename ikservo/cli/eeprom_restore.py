"""``ikservo setup --restore``: what differs from a backup, a question, and the writing."""

from __future__ import annotations

import sys
from pathlib import Path

from ikservo.arm.opening import open_bus
from ikservo.cli.prompts import confirm
from ikservo.cli.terminal import print_json, print_lines, print_status
from ikservo.errors import IkservoError, InputError
from ikservo.hardware.eeprom import read_backup
from ikservo.maintenance.eeprom_restore import Restoration, plan_restoration, restore
from ikservo.model import Model

__all__ = ["restore_backup"]


def restore_backup(
    model: Model,
    port: str | None,
    path: Path,
    *,
    target: str | None,
    other_model: bool,
    yes: bool,
    json: bool,
) -> None:
    """Write an EEPROM backup to its servo, after a question."""
    backup = read_backup(path)
    with open_bus(model, port) as bus:
        plan = plan_restoration(bus, backup, target, other_model=other_model)
        _tell(plan)
        if plan.changes and not (yes or _may_write(plan)):
            raise IkservoError("Cancelled; the servo was not changed.")
        restore(bus, plan)
    written = [_words(each.register.name, each.found, each.wanted) for each in plan.changes]
    if json:
        _print_json(plan, written)
    else:
        print_lines([f"✓ {plan.servo}: {', '.join(written) or 'nothing to change'}"])
    if written:
        print_status("A calibration may rest on what was changed. Check the arm: ikservo doctor")


def _tell(plan: Restoration) -> None:
    count = len(plan.changes)
    print_status(f"{plan.servo}: {count or 'no'} register{'s' * (count != 1)} to restore.")
    for each in plan.changes:
        print_status(f"    {_words(each.register.name, each.found, each.wanted)}")
    for each in plan.kept:
        print_status(f"    {each.register} stays {each.found}; the backup has {each.wanted}")


def _words(register: str, found: int, wanted: int) -> str:
    return f"{register} {found} → {wanted}"


def _may_write(plan: Restoration) -> bool:
    asked = f"Write these to {plan.servo}?"
    if not sys.stdin.isatty():
        raise InputError(f"{asked} Cannot ask: input is not a terminal.", "Give --yes.")
    return confirm(asked)


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

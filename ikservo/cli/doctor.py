"""``ikservo doctor``: is everything well between this computer and the servos?"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import asdict
from typing import Annotated

import typer

from ikservo.arm.care.checkup import check_up, rules_text
from ikservo.arm.care.eeprom_checks import write_eeprom
from ikservo.arm.care.findings import Finding, Level
from ikservo.arm.line import open_line
from ikservo.cli.choosing import chosen_model
from ikservo.cli.options import ArmOption, JsonOption, PortOption
from ikservo.cli.output import note, print_json, print_lines
from ikservo.cli.progress import bar
from ikservo.errors import ExitCode
from ikservo.model import load_model

__all__ = ["command"]

Rules = Annotated[bool, typer.Option("--rules", help="Only print the udev rule.")]
WriteEeprom = Annotated[
    bool, typer.Option("--write-eeprom", help="First write the EEPROM values of the arm file.")
]


def command(
    *,
    arm: ArmOption = None,
    port: PortOption = None,
    rules: Rules = False,
    eeprom: WriteEeprom = False,
    json: JsonOption = False,
) -> None:
    """Check adapter, bus and servos and report faults; nothing is changed.

    ikservo doctor

    ikservo doctor --arm so101 --port /dev/ttyACM0
    """
    if rules:
        print_lines(rules_text().splitlines())
        return
    if eeprom:
        _write(arm, port)
    with bar() as show:
        found = check_up(port, load_model(arm) if arm else None, show)
        findings = list(found if json else _shown(found))
    healthy = all(finding.level is not Level.BAD for finding in findings)
    if json:
        print_json("doctor", healthy=healthy, checks=[asdict(f) for f in findings])
    if not healthy:
        raise typer.Exit(ExitCode.FAILED)


def _shown(findings: Iterable[Finding]) -> Iterable[Finding]:
    """Print findings as they come."""
    for finding in findings:
        print_lines([f"{finding.level.mark} {finding.topic:9} {finding.text}"], indent=12)
        print_lines((f"            {line}".rstrip() for line in finding.fix.splitlines()), 12)
        yield finding


def _write(arm: str | None, port: str | None) -> None:
    model = chosen_model(arm)
    with open_line(model, port) as bus:
        for servo, changes in write_eeprom(bus, model).items():
            for change in changes:
                note(f"{servo}: {change.register} {change.found} → {change.wanted}")

"""``ikservo doctor``: diagnose adapter, bus and servos."""

from __future__ import annotations

from dataclasses import asdict
from typing import Annotated

import typer

from ikservo.apps.workbench.doctor import diagnose
from ikservo.apps.workbench.findings import Finding, Severity
from ikservo.apps.workbench.servo_checks import write_eeprom
from ikservo.arm.opening import open_bus
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import JsonOption, ServoConnection
from ikservo.cli.terminal import print_json, print_lines, print_status, progress_bar
from ikservo.control.stop_requests import exiting_on_signals
from ikservo.errors import ExitCode
from ikservo.hardware.serial_ports import read_rules
from ikservo.model import load_model

Rules = Annotated[bool, typer.Option("--rules", help="Print only the udev rule.")]
WriteEeprom = Annotated[
    bool, typer.Option("--write-eeprom", help="First write the EEPROM values from the arm file.")
]


def command(
    *,
    connection: ServoConnection,
    rules: Rules = False,
    eeprom: WriteEeprom = False,
    json: JsonOption = False,
) -> None:
    """Check adapter, bus and servos and report faults; nothing is changed.

    ikservo doctor

    ikservo doctor --arm so101 --port /dev/ttyACM0
    """
    if rules:
        print_lines(read_rules().splitlines())
        return
    if eeprom:
        model = model_from_option(connection.arm)
        with exiting_on_signals(), open_bus(model, connection.port) as bus:
            for servo, changes in write_eeprom(bus, model).items():
                for change in changes:
                    print_status(f"{servo}: {change}")
    with progress_bar() as show:
        model = load_model(connection.arm) if connection.arm else None
        findings: list[Finding] = []
        for finding in diagnose(connection.port, model, show):
            findings.append(finding)
            if not json:
                print_lines([f"{finding.level.mark} {finding.topic:9} {finding.text}"], indent=12)
                fix = finding.fix.splitlines()
                print_lines((f"            {line}".rstrip() for line in fix), 12)
    healthy = all(finding.level is not Severity.BAD for finding in findings)
    if json:
        print_json("doctor", healthy=healthy, checks=[asdict(f) for f in findings])
    if not healthy:
        raise typer.Exit(ExitCode.FAILED)

"""``ikservo scan``: every id at every baud rate in every protocol."""

from __future__ import annotations

from collections.abc import Generator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Annotated

import typer

from ikservo.cli.options import ArmOption, JsonOption, PortOption
from ikservo.cli.output import note, port_words, print_json, print_table
from ikservo.cli.progress import bar
from ikservo.errors import ExitCode, ServoSilentError
from ikservo.hardware.finding.discovery import (
    Found,
    Listener,
    ScanStep,
    baud_rates,
    choose_port,
    scan_port,
    with_arm,
)

__all__ = ["command"]

Port = Annotated[str | None, typer.Argument(metavar="[PORT]", help="The same as --port.")]
Every = Annotated[bool, typer.Option("--all", help="Go on after the first rate with servos.")]
Rates = Annotated[
    list[int] | None,
    typer.Option("--baud", min=1_200, max=12_000_000, help="Only this rate; may be repeated."),
]


def command(
    name: Port = None,
    *,
    port: PortOption = None,
    arm: ArmOption = None,
    rates: Rates = None,
    every: Every = False,
    json: JsonOption = False,
) -> None:
    """Find the servos on a port, whatever their ids and baud rates.

    ikservo scan /dev/ttyACM0

    ikservo scan --port sim --arm so101
    """
    where = with_arm(choose_port(name or port, arm or ""), _arm_file(arm))
    wanted = list(dict.fromkeys(rates or baud_rates()))
    with _watched() as draw:
        found = scan_port(where, wanted, every=every or bool(rates), on_step=draw)
    if not found:
        raise ServoSilentError(f"No servo found on {port_words(where)} {_silence(wanted)}", _HINT)
    _print(where, found, json=json)
    crowds = sorted({servo.id for servo in found if servo.crowded})
    if crowds:
        note(f"Several servos answer at id {', '.join(map(str, crowds))}.")
        note("Connect one servo at a time and give each its own id: ikservo setup ARM")
        raise typer.Exit(ExitCode.FAILED)


_HINT = "Check the servos' power supply and the cable, then: ikservo doctor"


def _silence(rates: Sequence[int]) -> str:
    at = f"{rates[0]} baud" if len(rates) == 1 else f"{len(rates)} baud rates"
    return f"(all ids, {at})"


def _arm_file(arm: str | None) -> Path | None:
    if not arm:
        return None
    from ikservo.model import find_arm  # noqa: PLC0415  # only the simulator needs to know

    return find_arm(arm)


def _print(port: str, found: Sequence[Found], *, json: bool) -> None:
    if json:
        print_json("scan", port=port, servos=[_facts(servo) for servo in found])
        return
    columns = ["id", "model", "baud", "firmware", "V", "°C", "protocol", "alarms"]
    print_table(columns, [_row(servo) for servo in found])


def _row(servo: Found) -> list[str]:
    return [
        str(servo.id),
        "SEVERAL SERVOS" if servo.crowded else servo.model or "unknown",
        str(servo.baud_rate),
        servo.firmware,
        "" if servo.voltage_v is None else f"{servo.voltage_v:.1f}",
        "" if servo.temperature_c is None else f"{servo.temperature_c:.0f}",
        servo.protocol,
        ", ".join(servo.alarms),
    ]


def _facts(servo: Found) -> dict[str, object]:
    return {
        "id": servo.id,
        "model": servo.table.model_name if servo.table else None,
        "model_number": servo.model_number,
        "baud_rate": servo.baud_rate,
        "protocol": servo.protocol,
        "firmware": servo.firmware,
        "voltage_v": servo.voltage_v,
        "temperature_c": servo.temperature_c,
        "alarms": servo.alarms,
        "several": servo.crowded,
    }


@contextmanager
def _watched() -> Generator[Listener | None]:
    with bar() as show:
        yield show and (lambda step: show(_said(step), step.asked, step.ids))


def _said(step: ScanStep) -> str:
    return f"{step.baud_rate} baud, {step.protocol}"

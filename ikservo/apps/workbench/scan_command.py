"""``ikservo scan``: search every id at every baud rate with every protocol."""

from __future__ import annotations

from collections.abc import Generator
from contextlib import contextmanager
from typing import Annotated

import typer

from ikservo.cli.options import ArmOption, JsonOption, ServoPortOption
from ikservo.cli.results import Field, Fields, print_records
from ikservo.cli.terminal import format_port, print_status, progress_bar
from ikservo.errors import ExitCode, ServoSilentError
from ikservo.hardware.port_choice import choose_port, simulated_port_url
from ikservo.hardware.scan import FoundServo, OnScanStep, candidate_baud_rates, scan_port

Port = Annotated[str | None, typer.Argument(metavar="[PORT]", help="The same as --port.")]
AllRates = Annotated[
    bool, typer.Option("--all", help="Try all rates, even after servos are found.")
]
Rates = Annotated[
    list[int] | None,
    typer.Option("--baud", min=1_200, max=12_000_000, help="Try only this rate; repeatable."),
]


def command(
    name: Port = None,
    *,
    port: ServoPortOption = None,
    arm: ArmOption = None,
    rates: Rates = None,
    all_rates: AllRates = False,
    json: JsonOption = False,
) -> None:
    """Find the servos on a port, whatever their ids and baud rates.

    ikservo scan /dev/ttyACM0

    ikservo scan --port sim --arm so101
    """
    if arm:  # imported here, because only the simulator needs a model
        from ikservo.arm.opening import resolve_port  # noqa: PLC0415
        from ikservo.model import load_model  # noqa: PLC0415

        port_url = resolve_port(load_model(arm), name or port)
    else:
        port_url = simulated_port_url(choose_port(name or port), None)
    baud_rates = list(dict.fromkeys(rates or candidate_baud_rates()))
    with _scan_progress() as draw:
        found = scan_port(port_url, baud_rates, all_rates=all_rates or bool(rates), on_step=draw)
    if not found:
        rate_count = len(baud_rates)
        tried = f"{baud_rates[0]} baud" if rate_count == 1 else f"{rate_count} baud rates"
        raise ServoSilentError(
            f"No servo found on {format_port(port_url)} (all ids, {tried})", _HINT
        )
    print_records("scan", "servos", found, _FIELDS, json=json, order=_COLUMNS, port=port_url)
    shared_ids = sorted({servo.id for servo in found if servo.shares_id})
    if shared_ids:
        print_status(f"Several servos answer at id {', '.join(map(str, shared_ids))}.")
        print_status("Connect one servo at a time and give each its own id: ikservo setup ARM")
    if not (all_rates or rates):
        print_status(f"The search ended at the first rate with servos, {found[-1].baud_rate} "
            f"baud. To search all rates: --all")  # fmt: skip
    if shared_ids:
        raise typer.Exit(ExitCode.FAILED)


_FIELDS: Fields[FoundServo] = (
    Field("id", "id"),
    Field(
        "model",
        "model",
        lambda servo: "SEVERAL SERVOS" if servo.shares_id else servo.model or "unknown",
        lambda servo: servo.table.model_name if servo.table else None,
    ),
    Field("model_number"),
    Field("baud_rate", "baud"),
    Field("protocol", "protocol"),
    Field("firmware", "firmware"),
    Field("voltage_v", "V", lambda s: "" if s.voltage_v is None else f"{s.voltage_v:.1f}"),
    Field(
        "temperature_c", "°C", lambda s: "" if s.temperature_c is None else f"{s.temperature_c:.0f}"
    ),
    Field("alarms", "alarms", lambda servo: list(servo.alarms)),
    Field("shares_id"),
)
_COLUMNS = "id model baud_rate firmware voltage_v temperature_c protocol alarms"
_HINT = "Check the servos' power supply and the cable, then: ikservo doctor"


@contextmanager
def _scan_progress() -> Generator[OnScanStep | None]:
    with progress_bar() as show:
        yield show and (
            lambda step: show(f"{step.baud_rate} baud, {step.protocol}", step.pinged, step.ids)
        )

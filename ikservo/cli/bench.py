"""``ikservo bench``: measure bus cycle times on this computer with this arm."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import JsonOption, ServoConnection
from ikservo.cli.terminal import print_json, print_status, print_table, progress_bar
from ikservo.lab.bus_benchmark import CYCLES, BusTiming, benchmark_bus
from ikservo.model import Model

__all__ = ["command"]


class BenchSubject(StrEnum):
    """What can be measured."""

    BUS = "bus"


What = Annotated[BenchSubject, typer.Argument(help="Subject of the measurement.")]
Count = Annotated[int, typer.Option("--count", min=10, help="Cycles of each kind.")]


def command(
    what: What,
    *,
    connection: ServoConnection,
    count: Count = CYCLES,
    json: JsonOption = False,
) -> None:
    """Measure how often per second all servos can be read and written; nothing moves.

    ikservo bench bus --arm so101 --port /dev/ttyACM0
    """
    model = model_from_option(connection.arm)
    with progress_bar() as show:
        speeds = benchmark_bus(
            model, connection.port, count, show and (lambda w, n: show(w, n, count))
        )
    if json:
        print_json(
            "bench",
            what=what,
            arm=model.name,
            baud_rate=model.baud_rate,
            rows=list(map(_speed_fields, speeds)),
        )
        return
    _print_speeds(speeds, model)


def _print_speeds(speeds: list[BusTiming], model: Model) -> None:
    servos = {joint.servo.model for joint in model.joints}
    print_status(
        f"{len(model.joints)} servos ({', '.join(sorted(servos))}) at {model.baud_rate} baud"
    )
    columns = ["each cycle", "cycles/s", "wire limit/s", "of limit", "p50 ms", "p99 ms",
               "p99.9 ms", "host ms", "bytes", "lost"]  # fmt: skip
    print_table(columns, [_format_speed_row(speed) for speed in speeds])


def _format_speed_row(speed: BusTiming) -> list[str]:
    return [
        speed.what,
        f"{speed.rate_hz:.0f}",
        f"{speed.limit_hz:.0f}",
        f"{100 * speed.rate_hz / speed.limit_hz:.0f} %",
        *(f"{1000 * speed.cycle_s(q):.3f}" for q in (0.5, 0.99, 0.999)),
        f"{1000 * speed.host_s:.3f}",
        str(speed.sent_bytes + speed.received_bytes),
        str(speed.lost),
    ]


def _speed_fields(speed: BusTiming) -> dict[str, object]:
    return {
        "what": speed.what,
        "cycles_per_s": speed.rate_hz,
        "wire_limit_per_s": speed.limit_hz,
        "p50_s": speed.cycle_s(0.5),
        "p99_s": speed.cycle_s(0.99),
        "p999_s": speed.cycle_s(0.999),
        "host_s": speed.host_s,
        "sent_bytes": speed.sent_bytes,
        "received_bytes": speed.received_bytes,
        "lost": speed.lost,
    }

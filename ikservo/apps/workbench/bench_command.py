"""``ikservo bench``: measure bus cycle times on this computer with this arm."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from ikservo.apps.workbench.bus_benchmark import CYCLES, BusTiming, benchmark_bus
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import JsonOption, ServoConnection
from ikservo.cli.results import Field, Fields, print_records
from ikservo.cli.terminal import print_status, progress_bar


class BenchSubject(StrEnum):
    """The subjects that can be measured."""

    BUS = "bus"


def _quantile(key: str, label: str, quantile: float) -> Field[BusTiming]:
    return Field(
        key,
        label,
        lambda bus: f"{1000 * bus.cycle_s(quantile):.3f}",
        lambda bus: bus.cycle_s(quantile),
    )


_FIELDS: Fields[BusTiming] = (
    Field("what", "each cycle"),
    Field("cycles_per_s", "cycles/s", lambda bus: f"{bus.rate_hz:.0f}", lambda bus: bus.rate_hz),
    Field(
        "wire_limit_per_s",
        "wire limit/s",
        lambda bus: f"{bus.limit_hz:.0f}",
        lambda bus: bus.limit_hz,
    ),
    Field("", "of limit", lambda bus: f"{100 * bus.rate_hz / bus.limit_hz:.0f} %"),
    _quantile("p50_s", "p50 ms", 0.5),
    _quantile("p99_s", "p99 ms", 0.99),
    _quantile("p999_s", "p99.9 ms", 0.999),
    Field("host_s", "host ms", lambda bus: f"{1000 * bus.host_s:.3f}"),
    Field("sent_bytes", "bytes", lambda bus: str(bus.sent_bytes + bus.received_bytes)),
    Field("received_bytes"),
    Field("lost", "lost"),
)

What = Annotated[BenchSubject, typer.Argument(help="What to measure.")]
Count = Annotated[int, typer.Option("--count", min=10, help="Cycles of each kind.")]


def command(
    what: What,
    *,
    connection: ServoConnection,
    count: Count = CYCLES,
    json: JsonOption = False,
) -> None:
    """Measure how many times per second all servos can be read and written; nothing moves.

    ikservo bench bus --arm so101 --port /dev/ttyACM0
    """
    model = model_from_option(connection.arm)
    with progress_bar() as show:
        speeds = benchmark_bus(
            model, connection.port, count, show and (lambda w, n: show(w, n, count))
        )
    if not json:
        servos = {joint.servo.model for joint in model.joints}
        print_status(
            f"{len(model.joints)} servos ({', '.join(sorted(servos))}) at {model.baud_rate} baud"
        )
    print_records("bench", "rows", speeds, _FIELDS, json=json,
                  what=what, arm=model.name, baud_rate=model.baud_rate)  # fmt: skip

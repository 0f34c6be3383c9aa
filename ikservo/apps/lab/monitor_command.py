"""``ikservo monitor``: log the health of an arm's servos, and report wear."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from datetime import UTC, datetime
from typing import Annotated

import typer

from ikservo.apps.lab.health_log import (
    Change,
    HealthRecord,
    JointHealth,
    append_record,
    changes_of,
    health_path,
    latest_health,
    measure_health,
    read_records,
)
from ikservo.arm.opening import open_bus, resolve_port
from ikservo.cli.model_options import model_from_option
from ikservo.cli.options import JsonOption, ServoConnection
from ikservo.cli.quantities import parse_time_s
from ikservo.cli.results import Field, Fields, json_values, print_records
from ikservo.cli.terminal import print_lines, print_status
from ikservo.hardware.port_names import serial_number_of
from ikservo.model import Model

Duration = Annotated[
    float | None,
    typer.Option("--duration", parser=parse_time_s, help="Duration of the readings; default: 2s."),
]
Report = Annotated[
    bool, typer.Option("--report", help="Report the changes so far, without reading the servos.")
]

_JOINTS: Fields[JointHealth] = (
    Field("name", "joint"),
    Field("id", "id"),
    Field("temperature_c", "°C", lambda one: _format(one.temperature_c, "{:.0f}")),
    Field("voltage_v", "V", lambda one: _format(one.voltage_v, "{:.1f}")),
    Field("load", "load", lambda one: _format(one.load, "{:.0%}")),
    Field(
        "backlash_rad",
        "backlash",
        lambda one: _format(one.backlash_rad, "{:.2f}°", math.degrees(1.0)),
    ),
    Field("friction_nm", "friction", lambda one: _format(one.friction_nm, "{:.3f} N m")),
    Field("requests"),
    Field("lost", "lost", lambda one: f"{one.lost} of {one.requests}"),
)
_CHANGES: Fields[Change] = (
    Field("joint"),
    Field("key"),
    Field("before"),
    Field("now"),
    Field("since"),
    Field("sigmas"),
)


def _format(value: float | None, form: str, scale: float = 1.0) -> str:
    return "–" if value is None else form.format(scale * value)


def command(
    *,
    connection: ServoConnection,
    duration: Duration = None,
    report: Report = False,
    json: JsonOption = False,
) -> None:
    """Log temperature, voltage, load and lost replies of an arm's servos; nothing moves.

    Each `ikservo identify` adds backlash and friction. Significant rises are reported.

    ikservo monitor --arm so101

    ikservo monitor --arm so101 --report
    """
    model = model_from_option(connection.arm)
    path = health_path(model.name, serial_number_of(resolve_port(model, connection.port)))
    records = read_records(path)
    if not report:
        with open_bus(model, connection.port) as bus:
            joints = measure_health(bus, 2.0 if duration is None else duration)
        record = HealthRecord(written=datetime.now(UTC), source="monitor", joints=joints)
        append_record(path, record)
        records = [*records, record]
    changes, latest = changes_of(records), latest_health(records)
    print_records(
        "monitor", "joints", latest, _JOINTS, json=json, path=path,
        count=len(records), changes=[json_values(each, _CHANGES) for each in changes],
    )  # fmt: skip
    if json:
        return
    print_lines([*map(_describe, changes), *_unknown_backlash(model, latest)])
    if not changes:
        count = f"{len(records)} record{'s' * (len(records) != 1)} so far"
        print_status(f"No wear found ({count} in {path}).")


def _unknown_backlash(model: Model, latest: Iterable[JointHealth]) -> Iterator[str]:
    """Yield the joints whose backlash is unknown, and how to measure it."""
    known = {one.name for one in latest if one.backlash_rad is not None}
    rows = [joint for joint in model.joints if joint.role == "arm" and joint.name not in known]
    blind = [one.name for one in rows if not one.servo.measures_current]
    if blind:
        yield (
            f"Backlash of {', '.join(blind)}: unknown, because their servos do not measure current"
        )
    others = [one.name for one in rows if one.name not in blind]
    if others:
        yield (
            f"Backlash of {', '.join(others)}: unknown until ikservo identify finds it, without "
            "--quick and with room for the arm to stand upright"
        )


def _describe(change: Change) -> str:
    if change.key == "backlash_rad":
        before, now = (f"{math.degrees(x):.1f}°" for x in (change.before, change.now))
        what = "backlash"
    else:
        before, now, what = f"{change.before:.3f}", f"{change.now:.3f} N m", "friction"
    since = f"{change.since:%Y-%m-%d}"
    return f"{change.joint}: {what} {before} → {now} since {since} ({change.sigmas:.1f} σ)"

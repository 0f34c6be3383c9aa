"""``ikservo fleet``: the arms of other machines in one table, once or continuously."""

from __future__ import annotations

import contextlib
import itertools
import sys
from collections.abc import Iterable
from typing import Annotated

import typer
from rich.live import Live
from rich.table import Table

from ikservo.apps.remote.address import parse_host
from ikservo.apps.remote.fleet import FleetArm, read_fleet
from ikservo.apps.remote.zenoh_network import fleet_hosts
from ikservo.cli.options import CountOption, JsonOption
from ikservo.cli.quantities import parse_time_s
from ikservo.cli.terminal import open_console, print_json, print_table
from ikservo.clock import RealClock
from ikservo.errors import PortError

Hosts = Annotated[
    list[str] | None,
    typer.Argument(metavar="[HOST[:PORT]]…", help="Machines; default: those in IKSERVO_FLEET."),
]
Watch = Annotated[bool, typer.Option("--watch", help="Repeat until Ctrl-C.")]
Period = Annotated[
    float,
    typer.Option(
        "--period",
        parser=parse_time_s,
        help="Time between two readings; default: 1s.",
        show_default=False,
    ),
]

_COLUMNS = ("arm", "at", "is", "state", "controlled by", "°C", "latency", "")


def command(
    hosts: Hosts = None,
    *,
    watch: Watch = False,
    period: Period = 1.0,
    count: CountOption = None,
    json: JsonOption = False,
) -> None:
    """List the arms that other machines serve: state, who controls them, health, latency.

    ikservo fleet lab-pi desk-pi --watch

    IKSERVO_FLEET=lab-pi,desk-pi ikservo fleet
    """
    endpoints = fleet_hosts(hosts or []) or [parse_host("127.0.0.1")]
    times, clock = count if watch else 1, RealClock()
    arms: list[FleetArm] = []
    with contextlib.suppress(KeyboardInterrupt):
        console = open_console()
        watched = console.is_terminal and times != 1
        live = Live(console=console, auto_refresh=False) if watched else None
        with live or contextlib.nullcontext():
            for number in itertools.count(1):
                arms = read_fleet(endpoints)
                if json:
                    print_json("fleet", arms=arms)
                    sys.stdout.flush()
                elif live is not None:
                    live.update(_table(arms), refresh=True)
                else:
                    print_table(_COLUMNS, map(_row, arms))
                if number == times:
                    break
                clock.sleep_until(clock.now_s() + period)
        if times == 1 and not any(arm.arm for arm in arms):
            raise PortError("No arm can be reached.", "Is `ikservo serve` running there?")


def _table(arms: Iterable[FleetArm]) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold")
    for column in _COLUMNS:
        justify = "right" if column in ("°C", "latency") else "left"
        table.add_column(column, justify=justify, no_wrap=bool(column))
    for arm in arms:
        table.add_row(*_row(arm))
    return table


def _row(arm: FleetArm) -> tuple[str, ...]:
    heat = "" if arm.temperature_c is None else f"{arm.temperature_c:.0f}"
    latency = "" if arm.latency_s is None else f"{1000 * arm.latency_s:.1f} ms"
    note = arm.error or arm.stopped_for or "; ".join(arm.alarms)
    return (arm.name, arm.host, arm.arm, arm.state, arm.operator, heat, latency, note)

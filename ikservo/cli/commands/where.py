"""``ikservo where``: show tip, joints, limits and health, once or continuously."""

from __future__ import annotations

import contextlib
import itertools
import math
import sys
from collections.abc import Callable, Generator, Iterator, Sequence
from contextlib import contextmanager
from typing import Annotated, Any

import numpy as np
import typer
from rich.console import Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from ikservo.app_discovery import find_part
from ikservo.arm import ArmState, JointState
from ikservo.arm.other_process import query_state
from ikservo.calibration import format_source
from ikservo.calibration.joint_limits import limit_distance, near_limit
from ikservo.cli.model_options import model_from_option
from ikservo.cli.open_and_confirm import open_from_options
from ikservo.cli.options import (
    ArmConnection,
    CountOption,
    JsonOption,
    MotionOptions,
    UncalibratedOption,
)
from ikservo.cli.posture_reports import posture_fields, posture_lines
from ikservo.cli.quantities import parse_point_m, parse_time_s
from ikservo.cli.terminal import open_console, print_json, print_lines, print_table
from ikservo.clock import Clock, RealClock
from ikservo.errors import IkservoError, InputError, format_point
from ikservo.kinematics.arrays import Vector
from ikservo.model import Model
from ikservo.model.arm_model import HealthLimits
from ikservo.planning.reports import describe_alarms

Watch = Annotated[bool, typer.Option("--watch", help="Repeat until Ctrl-C, with joints as bars.")]
Period = Annotated[
    float,
    typer.Option(
        "--period",
        parser=parse_time_s,
        help="Time between two readings; default: 200ms.",
        show_default=False,
    ),
]
VisibleFrom = Annotated[
    str | None,
    typer.Option(
        "--visible-from", metavar="X,Y,Z", help="List the links that a camera at this point sees."
    ),
]


def command(
    *,
    connection: ArmConnection,
    watch: Watch = False,
    period: Period = 0.2,
    count: CountOption = None,
    visible_from: VisibleFrom = None,
    uncalibrated: UncalibratedOption = False,
    json: JsonOption = False,
) -> None:
    """Show where the arm is, measured by its servos; nothing moves.

    If another ikservo program uses the port, that program answers instead.

    ikservo where --arm so101 --port sim --visible-from 0.6,0.3,0.4
    """
    model = model_from_option(connection.arm)
    eye_m = None if visible_from is None else parse_point_m(visible_from)
    if watch and eye_m is not None:
        raise InputError("--visible-from cannot be combined with --watch.", "Omit --watch.")
    if watch:
        watch_arm(model, connection.port, period, count, uncalibrated=uncalibrated, json=json)
        return
    here = query_state(model, connection.port)
    if here is None:
        with open_from_options(connection, MotionOptions(uncalibrated=uncalibrated)) as machine:
            here = machine.where()
    links: tuple[Any, ...] = ()  # each a `LinkVisibility` of the page
    if eye_m is not None:
        links = find_part("where --visible-from")(model, here.positions, eye_m)
    if json:
        more = posture_fields(model.chain, _chain_joints(here, model))
        more |= {} if eye_m is None else {"visible_from": _visibility_fields(eye_m, links)}
        print_json("where", tip_m=here.tip_m, joints=here.joints, **more)
        return
    _print_arm_state(here, model)
    if eye_m is not None:
        print_lines(["", f"seen from {format_point(eye_m)}"])
        rows: list[list[str]] = []
        for link in links:
            visible = f"{link.visible_fraction:.0%}" if link.is_visible else "hidden"
            rows.append([link.link, visible, ", ".join(link.hidden_by)])
        print_table(["link", "visible", "hidden by"], rows)


def _visibility_fields(
    eye_m: tuple[float, float, float], links: Sequence[Any]
) -> dict[str, object]:
    listed = [
        {
            "link": each.link,
            "visible_fraction": round(each.visible_fraction, 3),
            "hidden_by": each.hidden_by,
        }
        for each in links
    ]
    return {"eye_m": eye_m, "links": listed}


def _print_arm_state(here: ArmState, model: Model) -> None:
    posture = posture_lines(model.chain, _chain_joints(here, model))
    print_lines([f"tip {format_point(here.tip_m)}", *posture, ""])
    rows: list[list[str]] = []
    sources: dict[str, list[str]] = {}
    for state in here.joints:
        positions = (state.position_rad, state.lower_rad, state.upper_rad)
        rows.append(
            [
                state.name,
                *map(model.joint(state.name).joint_map.format, positions),
                f"{state.temperature_c:.0f}",
                f"{state.voltage_v:.1f}",
                "" if state.load_percent is None else f"{state.load_percent:z.0f} %",
                "on" if state.torque else "off",
            ]
        )
        sources.setdefault(format_source(state.limit_from), []).append(state.name)
    columns = ["joint", "position", "lower", "upper", "°C", "V", "load", "torque"]
    print_table(columns, rows)
    limits = [f"limits: {source} ({', '.join(joints)})" for source, joints in sources.items()]
    if len(sources) == 1:
        limits = [f"limits: {next(iter(sources))}"]
    alarms = [f"alarm: {names}: {text}" for names, text in describe_alarms(here.joints)]
    print_lines(["", *limits, *alarms], indent=4)


def _chain_joints(here: ArmState, model: Model) -> Vector:
    """Return the measured joints (dof,) of the chain, without the gripper."""
    return np.array([here[name].position_rad for name in model.chain.names])


# Widths of the bar between the limits and of the other columns, in characters.
_MIN_BAR_CHARS, _MAX_BAR_CHARS, _OTHER_COLUMNS_CHARS = 9, 31, 68

ReadState = Callable[[], ArmState]


def watch_arm(
    model: Model,
    port: str | None,
    period_s: float,
    count: int | None,
    *,
    uncalibrated: bool,
    json: bool,
    clock: Clock | None = None,
) -> None:
    """Print the arm's state periodically: lines of JSON, or a table that is updated in place.

    Without a clock, the computer's clock measures the period, for simulated arms too.
    """
    with (
        _state_reader(model, port, uncalibrated=uncalibrated) as read_state,
        contextlib.suppress(KeyboardInterrupt),  # Ctrl-C is the way to end it
    ):
        states = _poll_states(read_state, period_s, count, clock or RealClock())
        if json:
            for here in states:
                print_json("where", tip_m=here.tip_m, joints=here.joints)
                sys.stdout.flush()
            return
        console = open_console()
        with (
            Live(console=console, auto_refresh=False)
            if console.is_terminal
            else contextlib.nullcontext() as live
        ):
            for here in states:
                screen = _render_screen(here, model, console.width)
                live.update(screen, refresh=True) if live else console.print(screen)


@contextmanager
def _state_reader(model: Model, port: str | None, *, uncalibrated: bool) -> Generator[ReadState]:
    """Yield a function that reads the state from the program that has the port, or the servos."""
    if query_state(model, port) is not None:
        yield lambda: _read_from_owner(model, port)
        return
    connection = ArmConnection(arm=str(model.path), port=port)
    with open_from_options(connection, MotionOptions(uncalibrated=uncalibrated)) as machine:
        yield machine.where


def _read_from_owner(model: Model, port: str | None) -> ArmState:
    here = query_state(model, port)
    if here is None:
        raise IkservoError("The program that used the port has ended.", "Run the command again.")
    return here


def _poll_states(
    read_state: ReadState, period_s: float, count: int | None, clock: Clock
) -> Iterator[ArmState]:
    for number in itertools.count(1):
        yield read_state()
        if number == count:
            return
        clock.sleep_until(clock.now_s() + period_s)


def _render_screen(here: ArmState, model: Model, width: int) -> Group:
    table = Table(box=None, pad_edge=False, header_style="bold")
    alarms = ["alarms"] if any(state.alarms for state in here.joints) else []
    for column in ("joint", "position", "lower", "", "upper", "°C", "V", "load", "torque", *alarms):
        numeric = column in ("position", "lower", "upper", "°C", "V", "load")
        table.add_column(column, justify="right" if numeric else "left", no_wrap=True)
    length = min(max(width - _OTHER_COLUMNS_CHARS, _MIN_BAR_CHARS), _MAX_BAR_CHARS)
    for state in here.joints:
        joint_map = model.joint(state.name).joint_map
        format_value, colour = joint_map.format, limit_colour(state, joint_map.unit)
        bar = position_bar(state.position_rad, state.lower_rad, state.upper_rad, length)
        table.add_row(
            state.name,
            Text(format_value(state.position_rad), colour),
            format_value(state.lower_rad),
            Text(bar, colour),
            format_value(state.upper_rad),
            Text(f"{state.temperature_c:.0f}", heat_colour(state.temperature_c, model.health)),
            f"{state.voltage_v:.1f}",
            "" if state.load_percent is None else f"{state.load_percent:z.0f} %",
            "on" if state.torque else "off",
            *([Text(", ".join(state.alarms), "red")] if alarms else []),
        )
    return Group(f"tip {format_point(here.tip_m)}", "", table)


def heat_colour(temperature_c: float, limits: HealthLimits) -> str:
    """Return red at or above the stop temperature, yellow at or above the warning temperature."""
    hot, warm = (temperature_c >= c for c in (limits.hold_c, limits.warn_c))
    return "red" if hot else "yellow" if warm else ""


def limit_colour(state: JointState, unit: str) -> str:
    """Return red outside the limits, yellow near a limit."""
    joint = (state.position_rad, state.lower_rad, state.upper_rad)
    if limit_distance(*joint) < 0.0:
        return "red"
    return "yellow" if near_limit(*joint, unit) else ""


def position_bar(position: float, lower: float, upper: float, length: int) -> str:
    """Draw a position between two limits as ``├────●────┤``."""
    fraction = (position - lower) / (upper - lower) if math.isfinite(upper - lower) else 0.5
    at = min(max(round(fraction * (length - 1)), 0), length - 1)
    return f"├{'─' * at}●{'─' * (length - 1 - at)}┤"

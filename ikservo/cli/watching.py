"""``ikservo where --watch``: joints against their limits, heat and load, again and again."""

from __future__ import annotations

import contextlib
import itertools
import math
import sys
from collections.abc import Callable, Generator, Iterator
from contextlib import contextmanager

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from ikservo.arm import JointState, Whereabouts
from ikservo.arm.owner.elsewhere import ask_where
from ikservo.cli.output import point, print_json
from ikservo.cli.session import opened
from ikservo.clock import Clock, RealClock
from ikservo.errors import IkservoError
from ikservo.model import Model
from ikservo.model.health import HealthLimits
from ikservo.model.joint_limits import limit_distance, near_limit

__all__ = ["bar", "heat_colour", "limit_colour", "watch_arm"]

# Characters between the limits, and what the other columns take.
_SHORTEST, _LONGEST, _REST = 9, 31, 68

Look = Callable[[], Whereabouts]


def watch_arm(
    model: Model,
    port: str | None,
    interval_s: float,
    times: int | None,
    *,
    uncalibrated: bool,
    json: bool,
    clock: Clock | None = None,
) -> None:
    """Look until Ctrl-C, or so many times; a line of JSON each, or a table that stays in place.

    Args:
        model: The arm.
        port: Its port; chosen as for every command if None.
        interval_s: Between two looks.
        times: How many looks; until Ctrl-C if None.
        uncalibrated: Whether an arm without calibration may be opened.
        json: Whether to print lines of JSON.
        clock: Measures the interval; the computer's if None, on simulated arms too.
    """
    with _looking(model, port, uncalibrated=uncalibrated) as look, _quietly():
        looks = _looks(look, interval_s, times, clock or RealClock())
        if json:
            for here in looks:
                print_json("where", tip_m=here.tip_m, joints=here.joints)
                sys.stdout.flush()
            return
        console = Console(highlight=False)
        with Live(console=console, auto_refresh=False) if console.is_terminal else _plain() as live:
            for here in looks:
                screen = _screen(here, model, console.width)
                live.update(screen, refresh=True) if live else console.print(screen)


@contextmanager
def _looking(model: Model, port: str | None, *, uncalibrated: bool) -> Generator[Look]:
    """Yield what looks: through the program that owns the port, or on the port itself."""
    if ask_where(model, port) is not None:
        yield lambda: _asked(model, port)
        return
    with opened(str(model.path), port, uncalibrated=uncalibrated) as machine:
        yield machine.where


def _asked(model: Model, port: str | None) -> Whereabouts:
    here = ask_where(model, port)
    if here is None:
        raise IkservoError("The program that used the port has ended.", "Run the command again.")
    return here


def _plain() -> contextlib.nullcontext[None]:
    return contextlib.nullcontext()


@contextmanager
def _quietly() -> Generator[None]:
    with contextlib.suppress(KeyboardInterrupt):  # how a person ends it
        yield


def _looks(look: Look, interval_s: float, times: int | None, clock: Clock) -> Iterator[Whereabouts]:
    for number in itertools.count(1):
        yield look()
        if number == times:
            return
        clock.sleep_until(clock.now_s() + interval_s)


def _screen(here: Whereabouts, model: Model, width: int) -> Group:
    table = Table(box=None, pad_edge=False, header_style="bold")
    alarms = ["alarms"] if any(state.alarms for state in here.joints) else []
    for column in ("joint", "position", "lower", "", "upper", "°C", "V", "load", "torque", *alarms):
        numeric = column in ("position", "lower", "upper", "°C", "V", "load")
        table.add_column(column, justify="right" if numeric else "left", no_wrap=True)
    length = min(max(width - _REST, _SHORTEST), _LONGEST)
    for state in here.joints:
        row = _row(state, model, length)
        table.add_row(*row, *([Text(", ".join(state.alarms), "red")] if alarms else []))
    return Group(f"tip {point(here.tip_m.tolist())}", "", table)


def _row(state: JointState, model: Model, length: int) -> list[Text | str]:
    joint_map = model.joint(state.name).joint_map
    say, colour = joint_map.say, limit_colour(state, joint_map.unit)
    return [
        state.name,
        Text(say(state.position_rad), colour),
        say(state.lower_rad),
        Text(bar(state.position_rad, state.lower_rad, state.upper_rad, length), colour),
        say(state.upper_rad),
        Text(f"{state.temperature_c:.0f}", heat_colour(state.temperature_c, model.health)),
        f"{state.voltage_v:.1f}",
        "" if state.load_percent is None else f"{state.load_percent:z.0f} %",
        "on" if state.torque else "off",
    ]


def heat_colour(temperature_c: float, limits: HealthLimits) -> str:
    """Return red from the temperature on at which the arm holds, yellow where it warns."""
    hot, warm = (temperature_c >= c for c in (limits.hold_c, limits.warn_c))
    return "red" if hot else "yellow" if warm else ""


def limit_colour(state: JointState, unit: str) -> str:
    """Return red outside the limits, yellow near one."""
    joint = (state.position_rad, state.lower_rad, state.upper_rad)
    if limit_distance(*joint) < 0.0:
        return "red"
    return "yellow" if near_limit(*joint, unit) else ""


def bar(position: float, lower: float, upper: float, length: int) -> str:
    """Return ``├────●────┤``: where a position lies between two limits."""
    share = (position - lower) / (upper - lower) if math.isfinite(upper - lower) else 0.5
    at = min(max(round(share * (length - 1)), 0), length - 1)
    return f"├{'─' * at}●{'─' * (length - 1 - at)}┤"

"""What a person sees while calibrating: live meters on a terminal, plain lines elsewhere."""

from __future__ import annotations

import math
import sys
from collections.abc import Generator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from ikservo.arm.calibrating.steps import step_of
from ikservo.calibration.sweeping.meter import Meter, State, meters
from ikservo.calibration.sweeping.sweep import Stage, Wizard
from ikservo.calibration.ticks.words import JointUnit
from ikservo.cli.output import note
from ikservo.model import Model

__all__ = ["Screen", "screen"]

_LONGEST_BAR, _SHORTEST_BAR = 24, 8
_OTHER_COLUMNS = 64  # characters of a row beside the bar
_NARROW = _OTHER_COLUMNS + _SHORTEST_BAR  # below, the arm file's range is left out
_EVERY = 4  # readings between two pictures
_POSE_KEYS = "Enter take the pose   u undo   Ctrl-C stop without saving"
_DIRECTION_KEYS = "s skip joint   u undo   Ctrl-C stop without saving"
_SWEEP_KEYS = "Enter when all ✓   s skip   u undo   r again   f turns freely   Ctrl-C stop"


class Screen(Protocol):
    """Shows a conversation."""

    def show(self, wizard: Wizard) -> None:
        """Show where it is."""
        ...

    def tell(self, message: str) -> None:
        """Say something once."""
        ...


@contextmanager
def screen(model: Model, pose: str) -> Generator[Screen]:
    """Yield live meters where stderr is a terminal, else lines."""
    if not sys.stderr.isatty():
        yield _Lines(model, pose)
        return
    console = Console(stderr=True, highlight=False)
    with Live(console=console, refresh_per_second=15, transient=True) as live:
        yield _Live(model, pose, live)


class _Lines:
    """Says each thing once, one line each."""

    def __init__(self, model: Model, pose: str) -> None:
        self._model, self._pose, self._said = model, pose, ""

    def show(self, wizard: Wizard) -> None:
        line = str(step_of(self._model, self._pose, wizard))
        if line != self._said:
            self._said = line
            note(line)

    def tell(self, message: str) -> None:
        if message:
            note(message)


class _Live:
    """Draws a meter for each joint, again and again."""

    def __init__(self, model: Model, pose: str, live: Live) -> None:
        self._model, self._pose, self._live = model, pose, live
        self._message = ""
        self._beats = 0
        self._size = live.console.size

    def show(self, wizard: Wizard) -> None:
        self._beats += 1
        if self._beats % _EVERY:
            return
        self._clear_after_resize()
        step = step_of(self._model, self._pose, wizard)
        parts: list[Text | Table] = [Text(str(step), style="bold")]
        if wizard.stage is Stage.SWEEP:
            parts.append(_table(wizard, self._size.width))
        parts.append(Text(_keys(wizard), style="dim"))
        if self._message:
            parts.append(Text(self._message, style="yellow"))
        self._live.update(Group(*parts))

    def tell(self, message: str) -> None:
        self._message = message

    def _clear_after_resize(self) -> None:
        """Clear the screen: lines that the terminal has wrapped cannot be drawn over."""
        size = self._live.console.size
        if size != self._size:
            self._size = size
            self._live.console.clear()


def _keys(wizard: Wizard) -> str:
    if wizard.stage is Stage.ANCHOR:
        return _POSE_KEYS
    return _DIRECTION_KEYS if wizard.asked else _SWEEP_KEYS


def _table(wizard: Wizard, width: int) -> Table:
    """Draw a row for each joint, at most as wide as the terminal."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    columns = ["joint", "", "swept", "arm file", ""]
    wide = width >= _NARROW
    for column in columns if wide else [c for c in columns if c != "arm file"]:
        table.add_column(column, no_wrap=True, overflow="ellipsis")
    length = min(max(width - _OTHER_COLUMNS, _SHORTEST_BAR), _LONGEST_BAR)
    for meter in meters(wizard):
        name, bar, swept, expected, state = _row(meter, length, asked=wizard.asked is meter.subject)
        table.add_row(name, bar, swept, *([expected] if wide else []), state)
    return table


def _row(meter: Meter, length: int, *, asked: bool) -> list[Text]:
    unit, expected = meter.subject.joint_map.unit, meter.subject.expected
    moved = meter.state is not State.UNMOVED
    return [
        Text(meter.name, style="bold" if asked else ""),
        _bar(meter, length),
        Text(_range(meter.low, meter.high, unit) if moved else ""),
        Text(_range(expected.lower.value, expected.upper.value, unit), "dim"),
        Text(meter.state.value, style="green" if "✓" in meter.state.value else "yellow"),
    ]


def _range(low: float, high: float, unit: JointUnit) -> str:
    """Return ``-100° … 100°`` or ``15.0 … 37.0 mm``: short, for a table."""
    if unit == "m":
        return f"{low * 1000:z.1f} … {high * 1000:z.1f} mm"
    return f"{math.degrees(low):z.0f}° … {math.degrees(high):z.0f}°"


def _bar(meter: Meter, length: int) -> Text:
    """Draw where a joint is and has been between the limits of the arm file."""
    low, high = meter.subject.expected.lower.value, meter.subject.expected.upper.value

    def cell(position: float) -> int:
        return min(length - 1, max(0, round((position - low) / (high - low) * (length - 1))))

    cells = ["┄"] * length
    for k in range(cell(meter.low), cell(meter.high) + 1):
        cells[k] = "━"
    cells[cell(meter.position)] = "●"
    return Text("├" + "".join(cells) + "┤")

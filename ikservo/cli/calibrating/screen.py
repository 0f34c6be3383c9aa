"""What a person sees while calibrating: live meters on a terminal, plain lines elsewhere."""

from __future__ import annotations

import sys
from collections.abc import Generator
from contextlib import contextmanager
from typing import Protocol

from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from ikservo.calibration.sweeping.meter import Meter, State, meters
from ikservo.calibration.sweeping.sweep import Stage, Wizard
from ikservo.cli.output import note
from ikservo.model import Model
from ikservo.model.directions import direction

__all__ = ["Screen", "screen"]

_BAR = 24
_EVERY = 4  # readings between two pictures
_KEYS = "Enter when all ✓   u undo   s skip joint   r measure joint again   f turns freely"


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
    with Live(console=Console(stderr=True), refresh_per_second=15, transient=True) as live:
        yield _Live(model, pose, live)


class _Lines:
    """Says each thing once, one line each."""

    def __init__(self, model: Model, pose: str) -> None:
        self._model, self._pose, self._said = model, pose, ""

    def show(self, wizard: Wizard) -> None:
        line = _task(self._model, self._pose, wizard)
        if line != self._said:
            self._said = line
            note(line)

    def tell(self, message: str) -> None:
        note(message)


class _Live:
    """Draws a meter for each joint, again and again."""

    def __init__(self, model: Model, pose: str, live: Live) -> None:
        self._model, self._pose, self._live = model, pose, live
        self._message = ""
        self._beats = 0

    def show(self, wizard: Wizard) -> None:
        self._beats += 1
        if self._beats % _EVERY:
            return
        parts: list[Text | Table] = [Text(_task(self._model, self._pose, wizard), style="bold")]
        if wizard.stage is Stage.SWEEP:
            parts += [_table(wizard), Text(_KEYS, style="dim")]
        if self._message:
            parts.append(Text(self._message, style="yellow"))
        self._live.update(Group(*parts))

    def tell(self, message: str) -> None:
        self._message = message


def _task(model: Model, pose: str, wizard: Wizard) -> str:
    if wizard.stage is Stage.ANCHOR:
        state = "held still: press Enter." if wizard.still else "not still yet …"
        return f'1  Put the arm in the pose "{pose}": {state}'
    asked = wizard.asked
    if asked:
        way = direction(model, model.joint(asked.name), pose, asked.towards)
        return f"2  Move {asked.name} {way}."
    return "2  Now move every joint gently to both of its ends."


def _table(wizard: Wizard) -> Table:
    table = Table(box=None, pad_edge=False, show_header=False)
    for meter in meters(wizard):
        say = meter.subject.joint_map.say
        expected = meter.subject.expected
        table.add_row(
            Text(meter.name, style="bold" if wizard.asked is meter.subject else ""),
            _bar(meter),
            Text("" if meter.state is State.UNMOVED else f"{say(meter.low)} … {say(meter.high)}"),
            Text(f"expected {say(expected.lower.value)} … {say(expected.upper.value)}", "dim"),
            Text(meter.state.value, style="green" if "✓" in meter.state.value else "yellow"),
        )
    return table


def _bar(meter: Meter) -> Text:
    """Draw where a joint is and has been between the ends that the arm file expects."""
    low, high = meter.subject.expected.lower.value, meter.subject.expected.upper.value

    def cell(position: float) -> int:
        return min(_BAR - 1, max(0, round((position - low) / (high - low) * (_BAR - 1))))

    cells = ["┄"] * _BAR
    for k in range(cell(meter.low), cell(meter.high) + 1):
        cells[k] = "━"
    cells[cell(meter.position)] = "●"
    return Text("├" + "".join(cells) + "┤")

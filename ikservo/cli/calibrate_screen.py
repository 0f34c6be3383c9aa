"""Output of a calibration: its start, then live joint ranges on a terminal, lines elsewhere."""

from __future__ import annotations

import math
import sys
from collections import Counter
from collections.abc import Generator
from contextlib import contextmanager
from typing import Protocol

import typer
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from ikservo.calibration.joint_map import JointUnit
from ikservo.calibration.procedure import (
    CalibrationStage,
    CalibrationState,
    JointProgress,
    JointReadout,
    joint_readouts,
)
from ikservo.cli.terminal import confirm, print_status
from ikservo.errors import IkservoError, StoppedError
from ikservo.files.writing import check_writable
from ikservo.maintenance.arm_sketch import ascii_sketch
from ikservo.maintenance.calibration_session import TorqueOffArm
from ikservo.maintenance.calibration_steps import current_step
from ikservo.model import Model

__all__ = [
    "CalibrationDisplay",
    "calibration_display",
    "confirm_start",
    "disable_torque",
    "print_servos",
    "reporting_unchanged_state",
]

_MAX_BAR_CHARS, _MIN_BAR_CHARS = 24, 8
_OTHER_COLUMNS = 64  # characters of a row without its bar
_NARROW = _OTHER_COLUMNS + _MIN_BAR_CHARS  # below this width the arm file's range is omitted
_REFRESH_STEPS = 4  # readings per screen update
_POSE_KEYS = "Enter take the pose   u undo   Ctrl-C stop without saving"
_DIRECTION_KEYS = "s skip joint   u undo   Ctrl-C stop without saving"
_SWEEP_KEYS = "Enter when all ✓   s skip   u undo   r again   f turns freely   Ctrl-C stop"


class CalibrationDisplay(Protocol):
    """Shows the progress of a calibration."""

    def show(self, state: CalibrationState) -> None:
        """Show the current state."""
        ...

    def print_message(self, message: str) -> None:
        """Print a message once."""
        ...


@contextmanager
def calibration_display(model: Model, pose: str) -> Generator[CalibrationDisplay]:
    """Yield a live display if stderr is a terminal, else one that prints lines."""
    if not sys.stderr.isatty():
        yield _PlainDisplay(model, pose)
        return
    console = Console(stderr=True, highlight=False)
    with Live(console=console, refresh_per_second=15, transient=True) as live:
        yield _LiveDisplay(model, pose, live)


class _PlainDisplay:
    """Prints one line whenever the step changes."""

    def __init__(self, model: Model, pose: str) -> None:
        self._model, self._pose, self._last_line = model, pose, ""

    def show(self, state: CalibrationState) -> None:
        line = str(current_step(self._model, self._pose, state))
        if line != self._last_line:
            self._last_line = line
            print_status(line)

    def print_message(self, message: str) -> None:
        if message:
            print_status(message)


class _LiveDisplay:
    """Redraws a meter for each joint."""

    def __init__(self, model: Model, pose: str, live: Live) -> None:
        self._model, self._pose, self._live = model, pose, live
        self._message = ""
        self._updates = 0
        self._size = live.console.size

    def show(self, state: CalibrationState) -> None:
        self._updates += 1
        if self._updates % _REFRESH_STEPS:
            return
        self._clear_after_resize()
        step = current_step(self._model, self._pose, state)
        parts: list[Text | Table] = [Text(str(step), style="bold")]
        if state.stage is CalibrationStage.SWEEP:
            parts.append(_joint_table(state, self._size.width))
        parts.append(Text(_key_help(state), style="dim"))
        if self._message:
            parts.append(Text(self._message, style="yellow"))
        self._live.update(Group(*parts))

    def print_message(self, message: str) -> None:
        self._message = message

    def _clear_after_resize(self) -> None:
        """Clear the screen: lines wrapped by the terminal cannot be overwritten."""
        size = self._live.console.size
        if size != self._size:
            self._size = size
            self._live.console.clear()


def _key_help(state: CalibrationState) -> str:
    if state.stage is CalibrationStage.REFERENCE_POSE:
        return _POSE_KEYS
    return _DIRECTION_KEYS if state.current_joint else _SWEEP_KEYS


def _joint_table(state: CalibrationState, width: int) -> Table:
    """Return a table with a row for each joint, at most as wide as the terminal."""
    table = Table(box=None, pad_edge=False, header_style="dim")
    columns = ["joint", "", "swept", "arm file", ""]
    has_room = width >= _NARROW
    for column in columns if has_room else [c for c in columns if c != "arm file"]:
        table.add_column(column, no_wrap=True, overflow="ellipsis")
    length = min(max(width - _OTHER_COLUMNS, _MIN_BAR_CHARS), _MAX_BAR_CHARS)
    for meter in joint_readouts(state):
        name, bar, swept, expected, progress = _joint_row(
            meter, length, current=state.current_joint is meter.subject
        )
        table.add_row(name, bar, swept, *([expected] if has_room else []), progress)
    return table


def _joint_row(meter: JointReadout, length: int, *, current: bool) -> list[Text]:
    unit, expected = meter.subject.joint_map.unit, meter.subject.expected
    moved = meter.state is not JointProgress.UNMOVED
    return [
        Text(meter.name, style="bold" if current else ""),
        _range_bar(meter, length),
        Text(_format_range(meter.low, meter.high, unit) if moved else ""),
        Text(_format_range(expected.lower.value, expected.upper.value, unit), "dim"),
        Text(meter.state.value, style="green" if "✓" in meter.state.value else "yellow"),
    ]


def _format_range(low: float, high: float, unit: JointUnit) -> str:
    """Return ``-100° … 100°`` or ``15.0 … 37.0 mm``: short, for a table."""
    if unit == "m":
        return f"{low * 1000:z.1f} … {high * 1000:z.1f} mm"
    return f"{math.degrees(low):z.0f}° … {math.degrees(high):z.0f}°"


def _range_bar(meter: JointReadout, length: int) -> Text:
    """Return a bar with a joint's position and recorded range between the arm file's limits."""
    low, high = meter.subject.expected.lower.value, meter.subject.expected.upper.value

    def cell(position: float) -> int:
        return min(length - 1, max(0, round((position - low) / (high - low) * (length - 1))))

    cells = ["┄"] * length
    for k in range(cell(meter.low), cell(meter.high) + 1):
        cells[k] = "━"
    cells[cell(meter.position)] = "●"
    return Text("├" + "".join(cells) + "┤")


def confirm_start(question: str, *, default: bool, interactive: bool) -> bool:
    """Ask for yes or no; return the default if not interactive."""
    return confirm(question) if interactive else default


def disable_torque(limp_arm: TorqueOffArm, *, interactive: bool, yes: bool) -> None:
    """Switch torque off after the user has confirmed it.

    Raises:
        FileWriteError: No calibration could be saved afterwards.
        IkservoError: Servos hold the arm and it was not confirmed; nothing was changed.
    """
    for path in (limp_arm.path, limp_arm.journal_path):
        check_writable(path.parent)
    if limp_arm.settled:
        print_status(limp_arm.settled)
    holding = limp_arm.torque_on_servos()
    if holding:
        print_status("Torque will be switched off; support the arm.")
        if not yes and not confirm_start(
            "Switch torque off?", default=False, interactive=interactive
        ):
            raise IkservoError("Cancelled; nothing changed.", "Without asking: --yes")
    limp_arm.disable_torque()


@contextmanager
def reporting_unchanged_state() -> Generator[None]:
    """On Ctrl-C during a calibration by hand, report that nothing was saved.

    Raises:
        StoppedError: Instead of Ctrl-C or the end of the input.
    """
    try:
        yield
    except (KeyboardInterrupt, typer.Abort):
        raise StoppedError("Stopped: nothing was saved; torque is off.") from None


def print_servos(limp_arm: TorqueOffArm, pose: str) -> None:
    """Print the servos found and the reference pose."""
    servos = list(limp_arm.facts.values())
    counts = Counter(facts.table.model_name for facts in servos)
    listed = ", ".join(f"{count} {name}" for name, count in counts.items())
    firmware = ", ".join(sorted({facts.firmware for facts in servos}))
    print_status(
        f"{limp_arm.model.title} on {limp_arm.bus.port.name}: {listed}, firmware {firmware}."
    )
    for line in ascii_sketch(limp_arm.model, limp_arm.model.joints[-1].name, pose)[:-1]:
        print_status(f"    {line}")

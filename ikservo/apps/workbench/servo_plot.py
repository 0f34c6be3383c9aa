"""``ikservo servo plot``: registers of servos over time, as curves, CSV or lines of JSON."""

from __future__ import annotations

import contextlib
import math
import sys
from collections import deque
from collections.abc import Iterator, Sequence

from rich.live import Live
from rich.table import Table

from ikservo.apps.workbench.servo_samples import Sample, live_registers, sample_registers
from ikservo.apps.workbench.servo_workbench import ServoLine, find_register, shown_unit
from ikservo.cli.terminal import open_console, print_json, print_lines, print_status
from ikservo.hardware.register_batches import Register
from ikservo.hardware.servo import ServoSpec

_COLUMNS = ("servo", "register", "now", "lowest", "highest", "")
_BLOCKS = " ▁▂▃▄▅▆▇█"
_SHORTEST_CURVE, _OTHER_COLUMNS_CHARS = 10, 60
_TALL_ROWS, _TALL_UP_TO = 3, 6  # curves of three lines, for few of them

Curve = tuple[ServoSpec, Register]


def plot(
    line: ServoLine,
    servos: Sequence[ServoSpec],
    names: Sequence[str],
    period_s: float,
    duration_s: float | None,
    *,
    json: bool,
) -> None:
    """Print registers of servos until Ctrl-C: curves on a terminal, CSV or JSON for programs.

    Args:
        line: The servos of the line.
        servos: Those that are plotted.
        names: The registers, by the vendor's or the common names; those of motion if empty.
        period_s: Between two readings.
        duration_s: Ends after this time; None for none.
        json: Whether to print lines of JSON.

    Raises:
        UnknownNameError: A model has no such register.
        BusError: A servo does not reply.
    """
    watched = {
        servo.id: [find_register(servo.table, name) for name in names]
        or live_registers(servo.table)
        for servo in servos
    }
    curves = [(servo, register) for servo in servos for register in watched[servo.id]]
    ends_s = math.inf if duration_s is None else duration_s
    samples = sample_registers(line.bus, watched, period_s, ends_s)
    with contextlib.suppress(KeyboardInterrupt):  # the user ends it this way
        if json:
            for sample in samples:
                values = {
                    i: {r.name: x for r, x in row.items()} for i, row in sample.values.items()
                }
                rows = [{"id": each.id, "joint": each.name, "values": values[each.id]}
                        for each in servos if each.id in values]  # fmt: skip
                print_json("servo-sample", time_s=round(sample.time_s, 6), servos=rows)
        elif sys.stdout.isatty():
            _draw(samples, curves, period_s)
        else:
            _print_csv(samples, curves)


def _print_csv(samples: Iterator[Sample], curves: Sequence[Curve]) -> None:
    """Print a line for each sample; a servo that did not reply has empty cells."""
    units = [register.unit.symbol for _, register in curves]
    names = [f"{servo.name or servo.id}.{register}" for servo, register in curves]
    heads = [f"{name} [{unit}]" if unit else name for name, unit in zip(names, units, strict=True)]
    print_lines([f"time_s,{','.join(heads)}"])
    for sample in samples:
        values = (sample.values.get(servo.id, {}).get(register) for servo, register in curves)
        cells = ("" if value is None else f"{value:.6g}" for value in values)
        print_lines([f"{sample.time_s:.4f},{','.join(cells)}"])
        sys.stdout.flush()


def _draw(samples: Iterator[Sample], curves: Sequence[Curve], period_s: float) -> None:
    console = open_console()
    width = max(console.width - _OTHER_COLUMNS_CHARS, _SHORTEST_CURVE)
    rows = _TALL_ROWS if len(curves) <= _TALL_UP_TO else 1
    histories = [deque[float | None](maxlen=width) for _ in curves]
    print_status(f"The last {width * period_s:.3g} s; Ctrl-C ends.")
    with Live(console=console, auto_refresh=False) as live:
        for sample in samples:
            table = Table(*_COLUMNS, box=None, pad_edge=False)
            for (servo, register), history in zip(curves, histories, strict=True):
                unit, factor = shown_unit(register)
                value = sample.values.get(servo.id, {}).get(register)
                history.append(None if value is None else value * factor)
                known = [each for each in history if each is not None]
                shown = (history[-1], min(known, default=None), max(known, default=None))
                now, low, high = ("–" if each is None else f"{each:.4g}" for each in shown)
                owner, curve = servo.name or str(servo.id), "\n".join(block_curve(history, rows))
                table.add_row(owner, str(register), f"{now} {unit}", low, high, curve)
            live.update(table, refresh=True)


def block_curve(values: Sequence[float | None], rows: int) -> list[str]:
    """Return a curve as lines of blocks, the highest first, between its lowest and highest value.

    Args:
        values: One for each column; None is a gap.
        rows: Lines; each has eight steps.
    """
    known = [value for value in values if value is not None]
    low = min(known, default=0.0)
    per_step = (max(known, default=0.0) - low) / (8 * rows - 1) or 1.0
    steps = [0 if value is None else 1 + round((value - low) / per_step) for value in values]
    return [
        "".join(_BLOCKS[min(max(step - 8 * row, 0), 8)] for step in steps)
        for row in reversed(range(rows))
    ]

"""``ikservo servo plot``: show registers and angles over time, as curves, CSV or JSON lines."""

from __future__ import annotations

import contextlib
import difflib
import math
import sys
from collections import deque
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

from rich.live import Live
from rich.table import Table

from ikservo.apps.workbench.servo_samples import Sample, live_registers, sample_registers
from ikservo.apps.workbench.servo_workbench import ServoLine, find_register, shown_unit
from ikservo.calibration.joint_map import JointMap
from ikservo.cli.terminal import open_console, print_json, print_lines, print_status
from ikservo.errors import UnknownNameError
from ikservo.hardware.register_batches import Register
from ikservo.hardware.servo import ServoSpec
from ikservo.model import Model
from ikservo.planning.calibrated_arm import load_calibration_for
from ikservo.registers import RegisterName

_COLUMNS = ("servo", "register", "now", "lowest", "highest", "")
_BLOCKS = " ▁▂▃▄▅▆▇█"
_SHORTEST_CURVE, _OTHER_COLUMNS_CHARS = 10, 60
_TALL_ROWS, _TALL_UP_TO = 3, 6  # up to six curves have three lines each


@dataclass(frozen=True, slots=True)
class _Curve:
    """Curve of a servo's register, or of its joint's position, over time.

    Attributes:
        servo: The servo.
        register: The register that is read.
        joint: The map from its ticks to the joint position; None for the register itself.
    """

    servo: ServoSpec
    register: Register
    joint: JointMap | None = None

    def name_and_unit(self) -> tuple[str, str]:
        """Return the quantity and the unit of ``value``."""
        if self.joint is None:
            return str(self.register), self.register.unit.symbol
        return ("angle", "deg") if self.joint.unit == "rad" else ("position", "mm")

    def value(self, sample: Sample) -> float | None:
        """Return the value in a sample; None if the servo did not reply."""
        value = sample.values.get(self.servo.id, {}).get(self.register)
        if value is None or self.joint is None:
            return value
        position = self.joint.position_clamped(self.register.to_raw(value))
        return math.degrees(position) if self.joint.unit == "rad" else 1000.0 * position


def read_joint_maps(line: ServoLine, model: Model, words: Sequence[str]) -> dict[int, JointMap]:
    """Return the joint maps, by servo id, of the joints that the words name.

    Raises:
        CalibrationError: The arm's calibration contradicts its servos or its arm file.
    """
    joints = [joint for joint in model.joints if joint.name in words]
    if not joints:
        return {}
    own = load_calibration_for(line.bus, model)
    if not own.zeros.are_known:
        print_status(f"{model.name} is not calibrated; the nominal zeros of its arm file are used.")
    return {joint.servo.id: own.joint_map(joint) for joint in joints}


def show_plot(
    line: ServoLine,
    servos: Sequence[ServoSpec],
    names: Sequence[str],
    joints: Mapping[int, JointMap],
    period_s: float,
    duration_s: float | None,
    *,
    json: bool,
) -> None:
    """Print registers of servos until Ctrl-C: curves on a terminal, CSV or JSON for programs.

    Registers have the vendor's or the common names; by default, the registers of motion.

    Raises:
        UnknownNameError: A model has no such register.
        BusError: A servo does not reply.
    """
    named = {each.joint for each in joints.values()}
    registers = [name for name in names if name not in named]
    curves: list[_Curve] = []
    for servo in servos:
        watched_too = [_find_register(servo, name, servos) for name in registers]
        if servo.id in joints:
            present = servo.table.find(RegisterName.PRESENT_POSITION)
            curves.append(_Curve(servo, present, joints[servo.id]))
        elif not registers:
            watched_too = live_registers(servo.table)
        curves += [_Curve(servo, register) for register in watched_too]
    watched = {
        servo.id: list(dict.fromkeys(each.register for each in curves if each.servo == servo))
        for servo in servos
    }
    ends_s = math.inf if duration_s is None else duration_s
    samples = sample_registers(line.bus, watched, period_s, ends_s)
    with contextlib.suppress(KeyboardInterrupt):  # the user ends the plot with Ctrl-C
        if json:
            for sample in samples:
                values: dict[int, dict[str, float | None]] = {i: {} for i in sample.values}
                for each in curves:
                    if each.servo.id in values:
                        key = "_".join(each.name_and_unit()) if each.joint else str(each.register)
                        values[each.servo.id][key] = each.value(sample)
                rows = [{"id": each.id, "joint": each.name, "values": values[each.id]}
                        for each in servos if each.id in values]  # fmt: skip
                print_json("servo-sample", time_s=round(sample.time_s, 6), servos=rows)
        elif sys.stdout.isatty():
            _draw(samples, curves, period_s)
        else:
            _print_csv(samples, curves)


def _find_register(servo: ServoSpec, name: str, servos: Sequence[ServoSpec]) -> Register:
    """Find a register of a servo by name; the error suggests a joint with a similar name."""
    try:
        return find_register(servo.table, name)
    except UnknownNameError as error:
        joints = [each.name for each in servos]
        meant = [joint for joint in joints if name.lower() in joint.lower()]
        meant = meant or difflib.get_close_matches(name.lower(), joints, n=1)
        if meant:
            error.command_hint = f"Did you mean the joint {meant[0]}? {error.command_hint}"
        raise


def _print_csv(samples: Iterator[Sample], curves: Sequence[_Curve]) -> None:
    """Print a line per sample; a servo that did not reply has empty cells."""
    heads: list[str] = []
    for each in curves:
        name, unit = each.name_and_unit()
        head = f"{each.servo.name or each.servo.id}.{name}"
        heads.append(f"{head} [{unit}]" if unit else head)
    print_lines([f"time_s,{','.join(heads)}"])
    for sample in samples:
        values = (each.value(sample) for each in curves)
        cells = ("" if value is None else f"{value:.6g}" for value in values)
        print_lines([f"{sample.time_s:.4f},{','.join(cells)}"])
        sys.stdout.flush()


def _draw(samples: Iterator[Sample], curves: Sequence[_Curve], period_s: float) -> None:
    console = open_console()
    width = max(console.width - _OTHER_COLUMNS_CHARS, _SHORTEST_CURVE)
    rows = _TALL_ROWS if len(curves) <= _TALL_UP_TO else 1
    histories = [deque[float | None](maxlen=width) for _ in curves]
    print_status(f"Showing the last {width * period_s:.3g} s; Ctrl-C ends.")
    with Live(console=console, auto_refresh=False) as live:
        for sample in samples:
            table = Table(*_COLUMNS, box=None, pad_edge=False)
            for each, history in zip(curves, histories, strict=True):
                name, unit = each.name_and_unit()
                unit, factor = (unit, 1.0) if each.joint else shown_unit(each.register)
                value = each.value(sample)
                history.append(None if value is None else value * factor)
                known = [value for value in history if value is not None]
                shown = (history[-1], min(known, default=None), max(known, default=None))
                now, low, high = ("–" if value is None else f"{value:.4g}" for value in shown)
                owner = each.servo.name or str(each.servo.id)
                curve = "\n".join(block_curve(history, rows))
                table.add_row(owner, name, f"{now} {unit}", low, high, curve)
            live.update(table, refresh=True)


def block_curve(values: Sequence[float | None], rows: int) -> list[str]:
    """Return a curve as lines of blocks, the top line first, scaled to its range of values.

    There is one value per column, None for a gap; each line has eight steps.
    """
    known = [value for value in values if value is not None]
    low = min(known, default=0.0)
    per_step = (max(known, default=0.0) - low) / (8 * rows - 1) or 1.0
    steps = [0 if value is None else 1 + round((value - low) / per_step) for value in values]
    return [
        "".join(_BLOCKS[min(max(step - 8 * row, 0), 8)] for step in steps)
        for row in reversed(range(rows))
    ]

"""``ikservo calibrate --touch``: touch known points with the tip to calibrate the link geometry."""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from functools import partial
from pathlib import Path

import numpy as np
import typer

from ikservo.cli.answers import answers_from, apply_or_explain
from ikservo.cli.calibrate_screen import (
    confirm_start,
    disable_torque,
    print_servos,
    reporting_unchanged_state,
)
from ikservo.cli.options import parse_length_m
from ikservo.cli.terminal import (
    print_json,
    print_lines,
    print_status,
)
from ikservo.errors import CalibrationError, FileFormatError, IkservoError, format_point
from ikservo.files.reading import read_text
from ikservo.maintenance.calibration_session import TorqueOffArm, open_torque_off
from ikservo.maintenance.touch_off import TouchOffSession
from ikservo.model import Model
from ikservo.model.kinematic_calibration import Parameter
from ikservo.model.parameter_selection import CalibrationEstimate
from ikservo.model.touch_procedure import (
    ScriptedTouchAnswers,
    TouchOffState,
    TouchTarget,
    apply_answer,
    place_sheet,
    read_touch_script,
)

__all__ = [
    "TouchOffOptions",
    "describe_estimate",
    "estimate_fields",
    "read_points",
    "run_touch_off",
]


_DETERMINED = 0.5  # of the prior deviation: a parameter counts as identified from here on


def describe_estimate(state: TouchOffState, found: CalibrationEstimate) -> Iterator[str]:
    """Yield a summary of the estimate for the user, line by line."""
    fit = found.fit
    yield (
        f"Cross-validated tip error: {_format_mm(found.before_m)} before, "
        f"{_format_mm(found.after_m)} after "
        f"({len(state.touches)} touches; estimated: {found.extent.value})."
    )
    for touch, is_used, residual_m in zip(state.touches, fit.kept, fit.residuals_m, strict=True):
        if not is_used:
            yield f"Outlier, not used: {touch.point}, residual {_format_mm(float(residual_m))}."
    for parameter, value, deviation in _estimated_parameters(found):
        if deviation < _DETERMINED * parameter.prior:
            formatted = _format_parameter(value, parameter)
            yield f"{parameter.name}: {formatted} ± {_format_parameter(deviation, parameter)}"
    unknown = [p.name for p, _, d in _estimated_parameters(found) if d >= _DETERMINED * p.prior]
    if unknown:
        yield f"Not identified by these touches: {', '.join(unknown)}."
    identified = int(np.count_nonzero(fit.scaled > 1.0))
    yield f"Parameters identified: {identified} of {len(fit.scaled)}."
    median_m, percentile_95_m = found.deviation_m
    yield (
        f"Expected tip error (1 sigma) in the workspace: median {_format_mm(median_m)}, "
        f"95 % below {_format_mm(percentile_95_m)}."
    )


def estimate_fields(state: TouchOffState, found: CalibrationEstimate) -> dict[str, object]:
    """Return the estimate for ``--json``; metres and radians."""
    fit = found.fit
    rows = zip(state.touches, fit.kept.tolist(), fit.residuals_m.tolist(), strict=True)
    return {
        "changed": found.extent.value,
        "before_m": found.before_m,
        "after_m": found.after_m,
        "expected_m": found.deviation_m[0],
        "expected_worst_m": found.deviation_m[1],
        "touches": [
            {"point": touch.point, "used": used, "residual_m": residual_m}
            for touch, used, residual_m in rows
        ],
        "parameters": [
            {
                "name": parameter.name,
                "unit": parameter.unit,
                "value": value,
                "deviation": deviation,
                "deviation_before": parameter.prior,
                "determined": deviation < _DETERMINED * parameter.prior,
            }
            for parameter, value, deviation in _estimated_parameters(found)
        ],
        "singular_values": fit.scaled,
    }


def _estimated_parameters(found: CalibrationEstimate) -> list[tuple[Parameter, float, float]]:
    """Return each estimated parameter with its value and standard deviation."""
    fit = found.fit
    deviations = np.sqrt(np.diag(fit.covariance))
    rows = zip(fit.layout.parameters, fit.values.tolist(), deviations.tolist(), strict=True)
    return [row for row in rows if row[0].free]


def _format_parameter(value: float, parameter: Parameter) -> str:
    if parameter.unit == "m":
        return _format_mm(value)
    return f"{math.degrees(value):.2f}°"


def _format_mm(metres: float) -> str:
    return f"{1000 * metres:.1f} mm"


_MAX_BYTES = 64 * 1024
_EXPECTED = "NAME X Y Z, in metres or like 120mm, the arm's base frame"


def read_points(path: Path) -> list[TouchTarget]:
    """Return the points in a file; ``#`` starts a comment.

    Raises:
        FileFormatError: The file cannot be read, or a line is not a point; names the line.
    """
    targets: list[TouchTarget] = []
    for number, line in enumerate(read_text(path, _MAX_BYTES).splitlines(), start=1):
        fields = line.partition("#")[0].split()
        if fields:
            targets.append(_parse_target(path, f"line {number}", fields))
    return targets


def _parse_target(path: Path, where: str, fields: list[str]) -> TouchTarget:
    if len(fields) != 4:
        raise FileFormatError(path, where, "is not a point", _EXPECTED)
    try:
        return TouchTarget(fields[0], np.array([parse_length_m(field) for field in fields[1:]]))
    except typer.BadParameter as error:
        raise FileFormatError(path, where, error.message.rstrip("."), _EXPECTED) from error


_REPEATS = 20
_KEYS = {"\n": "touch", "\r": "touch", "s": "skip", "u": "undo", "a": "accept"}


@dataclass(frozen=True, slots=True)
class TouchOffOptions:
    """Options of a touch-off.

    Attributes:
        points: A file of points; None for the printed sheet.
        same_point: Whether one point of unknown position is touched repeatedly.
        edge_m: Distance from the base to the near edge of the sheet, metres; None to centre the
            sheet below the tool of the pose ``home``.
        block_m: Height of a block used at every other cross; None for none.
    """

    points: Path | None = None
    same_point: bool = False
    edge_m: float | None = None
    block_m: float | None = None


def run_touch_off(
    model: Model,
    port: str | None,
    options: TouchOffOptions,
    script: Path | None,
    *,
    yes: bool,
    interactive: bool,
    json: bool,
) -> None:
    """Run a touch-off, show its estimate, and save it if it improves the calibration.

    Raises:
        CalibrationError: The arm is not calibrated, or the touches do not suffice or do not
            improve the calibration.
        InputError: No user is there to answer.
    """
    answers = None
    if script or yes:
        answers = ScriptedTouchAnswers(read_touch_script(script) if script else None)
    with open_torque_off(model, port) as limp_arm:
        session = TouchOffSession(limp_arm)
        targets = session.reachable_targets(_make_targets(model, options))
        disable_torque(limp_arm, interactive=interactive, yes=yes or script is not None)
        with reporting_unchanged_state():
            print_servos(limp_arm, "home")
            state = _run_dialogue(
                limp_arm,
                session.start_touch_off(targets),
                answers,
                interactive=interactive,
            )
            found = _review_estimate(state, interactive=interactive)
            path = session.save(found, datetime.now(UTC))
    if json:
        print_json("touch-off", path=path, **estimate_fields(state, found))
    else:
        print_lines([f"Saved to {path}"])


def _review_estimate(state: TouchOffState, *, interactive: bool) -> CalibrationEstimate:
    """Show the estimate, and ask whether to save it.

    Raises:
        CalibrationError: It is no improvement.
        IkservoError: The user declined.
    """
    found = state.found
    assert found is not None  # noqa: S101  # the dialogue ends with an accepted estimate only
    for line in describe_estimate(state, found):
        print_status(f"  {line}")
    if not found.improves:
        raise CalibrationError(
            "Touch-off did not improve the calibration; nothing was saved.",
            "Touch more points, further apart and in more different postures.",
        )
    if not confirm_start("Save this?", default=True, interactive=interactive):
        raise IkservoError("Cancelled; nothing was saved, torque is off.")
    return found


def _make_targets(model: Model, options: TouchOffOptions) -> list[TouchTarget]:
    """Return the points to touch, and print where to put the sheet."""
    if options.same_point:
        print_status(
            "Put the tip on one fixed point again and again, each time in another posture."
        )
        return [TouchTarget("the point") for _ in range(_REPEATS)]
    if options.points:
        return read_points(options.points)
    edge_m, targets = place_sheet(model, options.edge_m, options.block_m)
    print_status(
        f"Lay the sheet docs/touch-grid.svg flat in front of the arm, its near edge "
        f"{edge_m * 1000:.0f} mm from the base's origin, its arrow pointing away from the arm."
    )
    return targets


def _run_dialogue(
    limp_arm: TorqueOffArm,
    state: TouchOffState,
    script: ScriptedTouchAnswers | None,
    *,
    interactive: bool,
) -> TouchOffState:
    """Read the servos and apply answers until there is an estimate."""
    last_line = ""
    with answers_from(script, _answer_for_key, interactive=interactive) as source:
        while state.found is None:
            reading = limp_arm.read_positions()
            if reading is None:
                continue
            state = state.update(*reading)
            last_line = _update_status_line(_format_task(state), last_line)
            answer = source.next_answer(state, reading[0])
            if answer:
                state = apply_or_explain(
                    partial(apply_answer, state, answer), state, source, print_status
                )
    return state


def _answer_for_key(_: TouchOffState, key: str) -> str | None:
    return _KEYS.get(key)


def _update_status_line(line: str, last_line: str) -> str:
    if line != last_line:
        print_status(line)
    return line


def _format_task(state: TouchOffState) -> str:
    done = len(state.touches)
    if state.current_target is None:
        return f"{done} points touched.  a evaluate   u undo   Ctrl-C stop"
    where = state.current_target.position_m
    place = "" if where is None else f" at {format_point(where)}"
    evaluate = "   a evaluate" if state.has_enough_touches else ""
    keys = f"Enter   s skip   u undo{evaluate}   Ctrl-C stop"
    number = f"Point {done + 1} of {done + len(state.places)}"
    return f"{number}: put the tip on {state.current_target.name}{place}.\n  {keys}"

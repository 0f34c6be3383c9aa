"""``ikservo calibrate --touch``: touch known points with the tip to calibrate the link geometry."""

from __future__ import annotations

import math
import sys
from collections.abc import Iterator
from contextlib import nullcontext
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Protocol

import numpy as np
import typer

from ikservo.cli.calibrate_screen import (
    confirm_start,
    disable_torque,
    print_servos,
    reporting_unchanged_state,
)
from ikservo.cli.options import parse_length_m
from ikservo.cli.terminal import (
    Keys,
    format_point,
    print_json,
    print_lines,
    print_status,
    read_keys,
)
from ikservo.errors import CalibrationError, FileFormatError, IkservoError, InputError
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


_DETERMINED = 0.5  # of what was believed before: a parameter known twice as well


def describe_estimate(talk: TouchOffState, found: CalibrationEstimate) -> Iterator[str]:
    """Yield what the person should know before saving, one line each."""
    fit = found.fit
    yield (
        f"Cross-validated tip error: {_format_mm(found.before_m)} before, "
        f"{_format_mm(found.after_m)} after "
        f"({len(talk.touches)} touches; estimated: {found.extent.value})."
    )
    for touch, good, residual_m in zip(talk.touches, fit.kept, fit.residuals_m, strict=True):
        if not good:
            yield f"Outlier, not used: {touch.point}, residual {_format_mm(float(residual_m))}."
    for parameter, value, deviation in _estimated_parameters(found):
        if deviation < _DETERMINED * parameter.prior:
            formatted = _format_parameter(value, parameter)
            yield f"{parameter.name}: {formatted} ± {_format_parameter(deviation, parameter)}"
    unknown = [p.name for p, _, d in _estimated_parameters(found) if d >= _DETERMINED * p.prior]
    if unknown:
        yield f"Not identified by these touches: {', '.join(unknown)}."
    told = int(np.count_nonzero(fit.scaled > 1.0))
    yield f"Parameters identified: {told} of {len(fit.scaled)}."
    middle_m, most_m = found.deviation_m
    yield (
        f"Expected tip error (1 sigma) in the workspace: median {_format_mm(middle_m)}, "
        f"95 % below {_format_mm(most_m)}."
    )


def estimate_fields(talk: TouchOffState, found: CalibrationEstimate) -> dict[str, object]:
    """Return the same for ``--json``; metres and radians."""
    fit = found.fit
    rows = zip(talk.touches, fit.kept.tolist(), fit.residuals_m.tolist(), strict=True)
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
    """Return each number that was estimated, with its value and standard deviation."""
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
    """Return the points in a file; ``#`` begins a remark.

    Raises:
        FileFormatError: The file cannot be read, or a line is no point; names the line.
    """
    places: list[TouchTarget] = []
    for number, line in enumerate(read_text(path, _MAX_BYTES).splitlines(), start=1):
        words = line.partition("#")[0].split()
        if words:
            places.append(_parse_target(path, f"line {number}", words))
    return places


def _parse_target(path: Path, where: str, words: list[str]) -> TouchTarget:
    if len(words) != 4:
        raise FileFormatError(path, where, "is not a point", _EXPECTED)
    try:
        return TouchTarget(words[0], np.array([parse_length_m(word) for word in words[1:]]))
    except typer.BadParameter as error:
        raise FileFormatError(path, where, error.message.rstrip("."), _EXPECTED) from error


_REPEATS = 20
_KEYS = {"\n": "touch", "\r": "touch", "s": "skip", "u": "undo", "a": "accept"}


@dataclass(frozen=True, slots=True)
class TouchOffOptions:
    """What the command line asks of a touch-off.

    Attributes:
        points: A file of points; None for the printed sheet.
        same_point: Whether one point that nobody has measured is touched again and again.
        edge_m: Where the near edge of the sheet lies, metres straight ahead; None for where the
            middle of the sheet is beneath the tool of the pose ``home``.
        block_m: The height of a block that stands at every other cross; None for none.
    """

    points: Path | None = None
    same_point: bool = False
    edge_m: float | None = None
    block_m: float | None = None


class _TouchAnswerSource(Protocol):
    def next_answer(self, state: TouchOffState, at_s: float) -> str | None:
        """Return the next answer, if there is one now."""
        ...


def run_touch_off(
    model: Model,
    port: str | None,
    wishes: TouchOffOptions,
    script: Path | None,
    *,
    yes: bool,
    asks: bool,
    json: bool,
) -> None:
    """Hold the conversation, show what it says, and save it where it helps.

    Raises:
        CalibrationError: The arm is not calibrated, the touches say too little, or nothing of
            what they say helps.
        InputError: Nobody is there to answer.
    """
    answers = read_touch_script(script) if script else None
    with open_torque_off(model, port) as loose:
        arm = TouchOffSession(loose)
        places = arm.reachable_targets(_make_targets(model, wishes))
        disable_torque(loose, asks=asks, yes=yes or script is not None)
        with reporting_unchanged_state():
            print_servos(loose, "home")
            talk = _run_dialogue(loose, arm.start_touch_off(places), answers, yes=yes, asks=asks)
            found = _review_estimate(talk, asks=asks)
            path = arm.save(found, datetime.now(UTC))
    if json:
        print_json("touch-off", path=path, **estimate_fields(talk, found))
    else:
        print_lines([f"Saved to {path}"])


def _review_estimate(talk: TouchOffState, *, asks: bool) -> CalibrationEstimate:
    """Show what the touches say, and ask whether to save it.

    Raises:
        CalibrationError: It is no improvement.
        IkservoError: The person said no.
    """
    found = talk.found
    assert found is not None  # noqa: S101  # only accepting ends a conversation
    for line in describe_estimate(talk, found):
        print_status(f"  {line}")
    if not found.improves:
        raise CalibrationError(
            "Touch-off did not improve the calibration; nothing was saved.",
            "Touch more points, further apart and in more different postures.",
        )
    if not confirm_start("Save this?", default=True, asks=asks):
        raise IkservoError("Cancelled; nothing was saved, torque is off.")
    return found


def _make_targets(model: Model, wishes: TouchOffOptions) -> list[TouchTarget]:
    """Return what shall be touched, and say where the sheet must lie."""
    if wishes.same_point:
        print_status(
            "Put the tip on one fixed point again and again, each time in another posture."
        )
        return [TouchTarget("the point") for _ in range(_REPEATS)]
    if wishes.points:
        return read_points(wishes.points)
    edge_m, places = place_sheet(model, wishes.edge_m, wishes.block_m)
    print_status(
        f"Lay the sheet docs/touch-grid.svg flat in front of the arm, its near edge "
        f"{edge_m * 1000:.0f} mm from the base's origin, its arrow pointing away from the arm."
    )
    return places


def _run_dialogue(
    loose: TorqueOffArm, talk: TouchOffState, answers: list[str] | None, *, yes: bool, asks: bool
) -> TouchOffState:
    """Read the servos and take answers until the touches have been reviewed."""
    scripted = yes or answers is not None
    if not scripted and not (asks and sys.stdin.isatty()):
        raise InputError(
            "Cannot ask: input is not a terminal.", "Give --yes, or --from-script FILE."
        )
    said = ""
    with nullcontext() if scripted else read_keys() as key:
        who: _TouchAnswerSource = (
            ScriptedTouchAnswers(answers) if key is None else _TouchKeyAnswers(key)
        )
        while talk.found is None:
            reading = loose.read_positions()
            if reading is None:
                continue
            talk = talk.update(*reading)
            said = _update_status_line(_format_task(talk), said)
            word = who.next_answer(talk, reading[0])
            talk = _apply_touch_answer(talk, word, scripted=scripted) if word else talk
    return talk


def _apply_touch_answer(talk: TouchOffState, word: str, *, scripted: bool) -> TouchOffState:
    try:
        return apply_answer(talk, word)
    except CalibrationError as error:
        if scripted:
            raise
        print_status(f"{error.message} {error.command_hint}")
        return talk


def _update_status_line(line: str, said: str) -> str:
    if line != said:
        print_status(line)
    return line


def _format_task(talk: TouchOffState) -> str:
    done = len(talk.touches)
    if talk.current_target is None:
        return f"{done} points touched.  a evaluate   u undo   Ctrl-C stop"
    where = talk.current_target.position_m
    place = "" if where is None else f" at {format_point(where.tolist())}"
    keys = (
        f"Enter   s skip   u undo{'   a evaluate' if talk.has_enough_touches else ''}   Ctrl-C stop"
    )
    number = f"Point {done + 1} of {done + len(talk.places)}"
    return f"{number}: put the tip on {talk.current_target.name}{place}.\n  {keys}"


class _TouchKeyAnswers:
    """A person at the keys."""

    def __init__(self, key: Keys) -> None:
        self._key = key

    def next_answer(self, state: TouchOffState, at_s: float) -> str | None:
        """Return what the first of the keys pressed since the last reading means here."""
        return _KEYS.get(self._key()[:1].lower())

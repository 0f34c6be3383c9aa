"""The dialogue of a touch-off: the user puts the tip on points, then reviews the estimate."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from ikservo.apps.calibrating.calibration_session import TorqueOffArm
from ikservo.apps.calibrating.kinematic_calibration import Parameter, TouchPoint
from ikservo.apps.calibrating.parameter_selection import MIN_TOUCHES, CalibrationEstimate
from ikservo.apps.calibrating.touch_procedure import TouchOffState
from ikservo.errors import (
    BadValueError,
    CalibrationError,
    IkservoError,
    InputError,
    format_point,
    shown,
)
from ikservo.maintenance.dialogue import (
    ACCEPT,
    Choice,
    Dialogue,
    HandRequest,
    Notice,
    Question,
    Unasked,
    read_answers,
)

TOUCH_ANSWERS = ("touch", "skip", "undo", ACCEPT)
_DETERMINED = 0.5  # a parameter is identified if its deviation is below this fraction of the prior


def read_touch_script(path: Path) -> list[str]:
    """Read the answers from a file, one per line; the touches are evaluated after the last answer.

    Raises:
        FileFormatError: The file cannot be read, or a line is not an answer.
    """
    return [*read_answers(path, TOUCH_ANSWERS), ACCEPT]


def touch_points(
    limp_arm: TorqueOffArm, state: TouchOffState, kept: list[TouchPoint] | None = None
) -> Dialogue[TouchOffState]:
    """Record touches until the user asks for their evaluation.

    If ``kept`` is given, it receives each touch, and the dialogue ends without evaluation.

    Raises:
        BusError: The servos stopped replying.
    """
    refused: IkservoError | None = None
    while state.found is None and (kept is None or state.current_target is not None):
        reading = limp_arm.read_positions()
        if reading is None:
            continue
        state = state.update(*reading)
        last = "evaluate" if kept is None else "finish"
        answer = yield _touch_request(state, reading[0], last, refused)
        if kept is not None and answer == ACCEPT:
            break
        if answer:
            try:
                state, refused = _apply_answer(state, answer), None
            except (CalibrationError, InputError) as error:
                refused = error
        if kept is not None:
            kept[:] = state.touches
    return state


def _apply_answer(state: TouchOffState, answer: str) -> TouchOffState:
    steps = {
        "touch": state.record_touch, "skip": state.skip, "undo": state.undo, ACCEPT: state.accept,
    }  # fmt: skip
    if answer not in steps:
        raise BadValueError("The answer", shown(answer), f"one of: {', '.join(TOUCH_ANSWERS)}")
    return steps[answer]()


def _touch_request(
    state: TouchOffState, at_s: float, last: str, refused: IkservoError | None
) -> HandRequest:
    """Return the next request to the user; ``last`` describes the effect of ``accept``."""
    target, done = state.current_target, len(state.touches)
    undo, skip = Choice("undo", "undo", "u"), Choice("skip", "skip", "s")
    if target is None:
        step, text = "", f"{done} points touched."
        choices = (Choice(ACCEPT, last, "a"), undo, Choice("touch", key="Enter"), skip)
    else:
        step = f"Point {done + 1} of {done + len(state.places)}"
        where = "" if target.position_m is None else f" at {format_point(target.position_m)}"
        text = f"put the tip on {target.name}{where}."
        wait_s = 0.0 if state.is_at_rest and state.has_moved else None
        ends = last == "finish" or done >= MIN_TOUCHES
        accept = Choice(ACCEPT, last if ends else "", "a")
        choices = (Choice("touch", "touch", "Enter", wait_s), skip, undo, accept)
    late = f"Timeout: the tip was not put on {target.name if target else 'the point'} within 60 s."
    missing = CalibrationError(late, "Guide the tip there and keep it still.")
    return HandRequest("touch", step, text, at_s, choices, (done,), missing, error=refused)


def estimate_geometry(
    limp_arm: TorqueOffArm, state: TouchOffState
) -> Dialogue[tuple[TouchOffState, CalibrationEstimate]]:
    """Let the user touch points, show the estimate, and ask whether to save it.

    Raises:
        CalibrationError: The touches do not suffice, or they do not improve the calibration.
        IkservoError: The user declined.
    """
    state = yield from touch_points(limp_arm, state)
    found = state.found
    assert found is not None  # noqa: S101  # the touches were evaluated
    for line in _describe_estimate(state, found):
        yield Notice(f"  {line}")
    if not found.improves:
        raise CalibrationError(
            "Touch-off did not improve the calibration; nothing was saved.",
            "Touch more points, further apart and in more different postures.",
        )
    if (yield Question("Save this?", Unasked.YES, stage="review", label="save")) != ACCEPT:
        raise IkservoError("Cancelled; nothing was saved, torque is off.")
    return state, found


def _describe_estimate(state: TouchOffState, found: CalibrationEstimate) -> Iterator[str]:
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

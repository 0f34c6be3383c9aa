"""``ikservo servo tune``: move a joint quickly with its present, given and best gains."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from operator import attrgetter

from ikservo.apps.workbench.gain_search import (
    DEFAULT_STEP_RAD,
    Trial,
    best_trial,
    find_turning_servo,
    try_gains,
    try_steps,
    tunable_registers,
)
from ikservo.apps.workbench.servo_sine import DEFAULT_AMPLITUDE_RAD, measure_sine
from ikservo.apps.workbench.servo_workbench import find_register, parse_register_value
from ikservo.arm.opening import require_own_port
from ikservo.cli.open_and_confirm import confirm_motion, open_from_options
from ikservo.cli.options import ArmConnection, MotionOptions
from ikservo.cli.results import Field, Fields, json_values, print_records
from ikservo.cli.terminal import format_port, print_status
from ikservo.errors import BadValueError, InputError
from ikservo.hardware.register_batches import Register
from ikservo.hardware.servo import ServoSpec


def _format_degrees(angle_rad: float) -> str:
    return f"{math.degrees(angle_rad):.2f}°"


def _response(key: str, label: str, form: Callable[[float], str]) -> Field[Trial]:
    """Return the field of a value of the response, such as ``lag_s``."""
    value = attrgetter(f"response.{key}")
    return Field(key, label, lambda one: form(value(one)), value)


_FIELDS: Fields[Trial] = (
    Field("gains", "gains", lambda one: _format_gains(one.gains), lambda one: _named(one.gains)),
    _response("overshoot_rad", "overshoot", _format_degrees),
    _response("settling_s", "settling", "{:.2f} s".format),
    _response("steady_error_rad", "short of goal", _format_degrees),
    _response("swing_rad", "swings by", _format_degrees),
    _response("lag_s", "lag", lambda lag_s: f"{1000 * lag_s:.0f} ms"),
)


@dataclass(frozen=True, slots=True)
class _SineRow:
    gains: Mapping[Register, int]
    frequency_hz: float
    amplitude_ratio: float
    phase_lag_rad: float
    swing_rad: float


_SINE_FIELDS: Fields[_SineRow] = (
    Field("gains", "gains", lambda one: _format_gains(one.gains), lambda one: _named(one.gains)),
    Field("frequency_hz", "frequency", lambda one: f"{one.frequency_hz:.2f} Hz"),
    Field("amplitude_ratio", "amplitude", lambda one: f"{one.amplitude_ratio:.0%}"),
    Field("phase_lag_rad", "phase lag", lambda one: f"{math.degrees(one.phase_lag_rad):.0f}°"),
    Field("swing_rad", "swings by", lambda one: _format_degrees(one.swing_rad)),
)


def _named(gains: Mapping[Register, int]) -> dict[str, int]:
    return {register.name: raw for register, raw in gains.items()}


def _format_gains(gains: Mapping[Register, int]) -> str:
    return ", ".join(f"{register} {raw}" for register, raw in gains.items())


def tune_joint(
    connection: ArmConnection,
    joint: str | None,
    settings: Sequence[str],
    far_rad: float | None,
    sine_hz: tuple[float, float] | None,
    *,
    suggest: bool,
    yes: bool,
    json: bool,
) -> None:
    """Measure a joint with its present and the given gains, and on request search for better gains.

    The present gains are restored at the end. Gains to try are written ``p_gain=16``. ``far_rad``
    is the size of the step or, with the lowest and highest frequency ``sine_hz``, the amplitude of
    a sine.

    Raises:
        InputError: No joint is named, or it does not turn.
        RefusedError: There is no room, or the servo has no such gains.
    """
    if joint is None:
        raise InputError(
            "No joint was given.", "For example: ikservo servo tune --arm so101 --id 3"
        )
    if suggest and sine_hz:
        raise InputError(
            "Gains can only be suggested from a step, not from a sine.", "Omit --sine or --suggest."
        )
    if far_rad is None:
        far_rad = DEFAULT_AMPLITUDE_RAD if sine_hz else DEFAULT_STEP_RAD
    with open_from_options(connection, MotionOptions(yes=yes)) as machine:
        arm = require_own_port(machine)
        servo = find_turning_servo(arm, joint)
        given = _parse_gains(servo, settings)
        what = "there and back"
        if sine_hz:
            what = f"to both sides, {' to '.join(f'{hz:g}' for hz in sorted(set(sine_hz)))} Hz,"
        print_status(
            f"{servo} of {arm.model.title} on {format_port(arm.port_name)}: "
            f"moves {math.degrees(far_rad):.3g}° {what} at the fast speed, "
            f"{'about ten times' if suggest else 'once' if not given else 'twice'}."
        )
        confirm_motion(machine, yes=yes)
        if sine_hz:
            sines = try_gains(
                arm, servo, given,
                lambda gains: (gains, measure_sine(arm, servo.name, far_rad, *sine_hz)),
            )  # fmt: skip
            rows = [
                _SineRow(
                    gains, at.frequency_hz, at.amplitude_ratio, at.phase_lag_rad, one.swing_rad
                )
                for gains, one in sines
                for at in one.points
            ]
            print_records(
                "servo-sine", "points", rows, _SINE_FIELDS, json=json, id=servo.id,
                joint=servo.name, model=servo.table.model_name,
            )  # fmt: skip
            return
        trials = try_steps(arm, servo, given, far_rad, suggest=suggest)
    best = best_trial(trials)
    print_records(
        "servo-tune", "trials", trials, _FIELDS, json=json, id=servo.id, joint=servo.name,
        model=servo.table.model_name, best=json_values(best, _FIELDS),
    )  # fmt: skip
    if not json and len(trials) > 1:
        _print_advice(connection, servo, trials[0], best)


def _parse_gains(servo: ServoSpec, settings: Sequence[str]) -> dict[Register, int]:
    gains: dict[Register, int] = {}
    for word in settings:
        name, equals, text = word.partition("=")
        register = find_register(servo.table, name)
        if not equals or register not in tunable_registers(servo):
            listed = " ".join(f"{each}=16" for each in tunable_registers(servo))
            raise InputError(
                f"{word!r} does not set a gain.", f"For example: ikservo servo tune {listed}"
            )
        gains[register] = parse_register_value(register, text)
        lower, upper = register.range
        if not lower <= gains[register] <= upper:
            raise BadValueError(f"{register} of {servo}", gains[register], f"{lower} to {upper}")
    return gains


def _print_advice(connection: ArmConnection, servo: ServoSpec, present: Trial, best: Trial) -> None:
    if present.response.swings and best is present:
        print_status(f"{servo} does not come to rest with any of the gains tried.")
    if best is present:
        print_status("The present gains are the best of those tried and are kept.")
        return
    words = " ".join(f"{name}={raw}" for name, raw in _named(best.gains).items())
    print_status(
        "The previous gains have been restored. To keep the best gains tried, switch torque off, "
        f"then: ikservo servo write {words} --arm {connection.arm} --id {servo.id}"
    )

"""``ikservo servo tune``: a joint's quick motion with its gains, with others, with the best."""

from __future__ import annotations

import math
import signal
from collections.abc import Generator, Mapping, Sequence
from contextlib import contextmanager

from ikservo.arm.arm import Arm
from ikservo.arm.opening import require_own_port
from ikservo.cli.options import ArmConnection, MotionOptions
from ikservo.cli.results import Field, Fields, json_values, print_records
from ikservo.cli.session import confirm_motion, open_from_options
from ikservo.cli.terminal import format_port, print_status
from ikservo.errors import BadValueError, InputError, UnknownNameError
from ikservo.hardware.read_plan import Register
from ikservo.hardware.servo import ServoSpec
from ikservo.lab.servo_tuning import (
    Trial,
    gain_registers,
    keeping_gains,
    measure_response,
    search_gains,
    write_gains,
)
from ikservo.maintenance.servo_workbench import find_register, parse_register_value

__all__ = ["tune"]

_FIELDS: Fields[Trial] = (
    Field(
        "gains",
        "gains",
        lambda one: ", ".join(f"{key} {raw}" for key, raw in one.named_gains.items()),
        lambda one: dict(one.named_gains),
    ),
    Field(
        "overshoot_rad",
        "overshoot",
        lambda one: _format_degrees(one.response.overshoot_rad),
        lambda one: one.response.overshoot_rad,
    ),
    Field(
        "settling_s",
        "settling",
        lambda one: f"{one.response.settling_s:.2f} s",
        lambda one: one.response.settling_s,
    ),
    Field(
        "steady_error_rad",
        "short of goal",
        lambda one: _format_degrees(one.response.steady_error_rad),
        lambda one: one.response.steady_error_rad,
    ),
    Field(
        "swing_rad",
        "swings by",
        lambda one: _format_degrees(one.response.swing_rad),
        lambda one: one.response.swing_rad,
    ),
    Field(
        "lag_s",
        "lag",
        lambda one: f"{1000 * one.response.lag_s:.0f} ms",
        lambda one: one.response.lag_s,
    ),
)


def _format_degrees(angle_rad: float) -> str:
    return f"{math.degrees(angle_rad):.2f}°"


def tune(
    connection: ArmConnection,
    joint: str | None,
    settings: Sequence[str],
    step_rad: float,
    *,
    suggest: bool,
    yes: bool,
    json: bool,
) -> None:
    """Measure a joint with its present gains, with those given, and, if asked, with the best found.

    The present gains are in force again at the end.

    Raises:
        InputError: No joint is named, or it does not turn.
        RefusedError: There is no room, or the servo has no such gains.
    """
    if joint is None:
        raise InputError("No joint is named.", "As in: ikservo servo tune --arm so101 --id 3")
    with open_from_options(connection, MotionOptions(yes=yes)) as machine:
        arm = require_own_port(machine)
        servo = _find_turning_servo(arm, joint)
        given = _parse_gains(servo, settings)
        print_status(
            f"{servo} of {arm.model.title} on {format_port(arm.port_name)}: "
            f"{math.degrees(step_rad):.0f}° there and back at the speed fast, "
            f"{'some ten times' if suggest else 'once' if not given else 'twice'}."
        )
        confirm_motion(machine, yes=yes)
        with _ending_in_order():
            trials = _run_trials(arm, servo, given, step_rad, suggest=suggest)
    best = min(trials, key=lambda one: one.response.cost)
    print_records(
        "servo-tune", "trials", trials, _FIELDS, json=json, id=servo.id, joint=servo.name,
        model=servo.table.model_name, best=json_values(best, _FIELDS),
    )  # fmt: skip
    if not json and len(trials) > 1:
        _print_advice(connection, servo, trials[0], best)


@contextmanager
def _ending_in_order() -> Generator[None]:
    """Let a signal that ends the program restore the gains first."""
    signals = [signal.SIGTERM, *([signal.SIGHUP] if hasattr(signal, "SIGHUP") else [])]

    def leave(number: int, _frame: object) -> None:
        raise SystemExit(128 + number)

    before = {each: signal.signal(each, leave) for each in signals}
    try:
        yield
    finally:
        for each, handler in before.items():
            signal.signal(each, handler)


def _parse_gains(servo: ServoSpec, settings: Sequence[str]) -> dict[Register, int]:
    gains: dict[Register, int] = {}
    for word in settings:
        name, equals, text = word.partition("=")
        register = find_register(servo.table, name)
        if not equals or register not in gain_registers(servo):
            listed = " ".join(f"{each}=16" for each in gain_registers(servo))
            raise InputError(f"{word!r} sets no gain.", f"As in: ikservo servo tune {listed}")
        gains[register] = parse_register_value(register, text)
        lower, upper = register.range
        if not lower <= gains[register] <= upper:
            raise BadValueError(f"{register} of {servo}", gains[register], f"{lower} to {upper}")
    return gains


def _find_turning_servo(arm: Arm, joint: str) -> ServoSpec:
    servos = list(arm.context.servos.bus.servos.values())
    found = [each for each in servos if joint in (each.name, str(each.id))]
    if not found:
        raise UnknownNameError("joint", joint, [each.name for each in servos])
    if found[0].name not in arm.chain.names:
        raise InputError(f"{found[0]} is no joint of the chain.", "Name one that moves the tip.")
    return found[0]


def _run_trials(
    arm: Arm, servo: ServoSpec, given: Mapping[Register, int], step_rad: float, *, suggest: bool
) -> list[Trial]:
    bus = arm.context.servos.bus
    with keeping_gains(bus, servo) as present:
        trials = [Trial(present, measure_response(arm, servo.name, step_rad))]
        if given:
            gains = {each: given.get(each, raw) for each, raw in present.items()}
            write_gains(bus, servo, gains)
            trials.append(Trial(gains, measure_response(arm, servo.name, step_rad)))
        if suggest:
            best = min(trials, key=lambda one: one.response.cost)
            trials += search_gains(arm, servo, best, step_rad)
    return trials


def _print_advice(connection: ArmConnection, servo: ServoSpec, present: Trial, best: Trial) -> None:
    if present.response.swings and best is present:
        print_status(f"{servo} does not come to rest with any gains that were tried.")
    if best is present:
        print_status("The present gains are the best of these; they are in force.")
        return
    words = " ".join(f"{name}={raw}" for name, raw in best.named_gains.items())
    print_status(
        "The former gains are in force again. To keep the best of these, switch torque off, then: "
        f"ikservo servo write {words} --arm {connection.arm} --id {servo.id}"
    )

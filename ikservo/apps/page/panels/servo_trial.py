"""Gain trials on the servo page: step responses of a joint with present and other gains."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence

import numpy as np

from ikservo.apps.page.server.server import Frame
from ikservo.apps.workbench.gain_search import (
    Trial,
    best_trial,
    find_turning_servo,
    try_steps,
    tunable_registers,
)
from ikservo.apps.workbench.servo_workbench import find_register
from ikservo.arm.arm import Arm
from ikservo.errors import BadValueError, InputError, RefusedError
from ikservo.hardware.register_batches import Register
from ikservo.hardware.servo import ServoSpec

_ROWS = 200  # number of rows of a plot


def tunable_names(servo: ServoSpec) -> list[str]:
    """Return the registers with sliders on the page; none if the model has no gains."""
    with contextlib.suppress(RefusedError):
        return [register.name for register in tunable_registers(servo)]
    return []


def try_on_joint(
    arm: Arm, joint: str, gains: Mapping[str, int], step_deg: float, *, suggest: bool
) -> list[Trial]:
    """Return step responses of a joint with its present, the given, and searched gains.

    Gains are raw numbers by register; numbers that are already set are ignored.

    Raises:
        InputError: There are no other gains to try, or the joint does not turn.
        IkservoError: The errors of every motion; the present gains are restored.
    """
    servo = find_turning_servo(arm, joint)
    bus = arm.context.servos.bus
    given: dict[Register, int] = {}
    for name, raw in gains.items():
        register = find_register(servo.table, name)
        lower, upper = register.range
        if register not in tunable_registers(servo) or not lower <= raw <= upper:
            raise BadValueError(f"{register} of {servo}", raw, f"a gain from {lower} to {upper}")
        if bus.read(servo.id, register, raw=True) != raw:
            given[register] = raw
    if not given and not suggest:
        raise InputError("These are the present gains.", "Move a slider, or ask for a suggestion.")
    return try_steps(arm, servo, given, math.radians(step_deg), suggest=suggest)


def describe_trials(trials: Sequence[Trial]) -> str:
    """Describe the responses with the present gains and with the best other gains."""
    text = ""
    for name, trial in zip(("before", "after"), _compared(trials), strict=True):
        response = trial.response
        words = [
            ", ".join(f"{register} {raw}" for register, raw in trial.gains.items()),
            f"overshoot {np.degrees(response.overshoot_rad):.2f}°",
            f"settling {response.settling_s:.2f} s",
            f"{np.degrees(response.steady_error_rad):.2f}° short of its goal",
            f"swings by {np.degrees(response.swing_rad):.2f}°"
            if response.swings
            else "comes to rest",
        ]
        text += f"{name}: {'; '.join(words)}. "
    return f"{text}The former gains are restored; the joint holds."


def trial_frame(joint: str, trials: Sequence[Trial]) -> Frame:
    """Return goals and positions of both responses on one time axis, for a plot."""
    before, after = _compared(trials)
    end_s = max(float(one.response.time_s[-1]) for one in (before, after))
    times = np.linspace(0.0, end_s, _ROWS)
    start_rad = float(before.response.goal_rad[0])
    columns = {
        "goal": (before, before.response.goal_rad),
        "before": (before, before.response.position_rad),
        "after": (after, after.response.position_rad),
    }
    values = [
        np.degrees(np.interp(times, one.response.time_s, rad) - start_rad).round(3).tolist()
        for one, rad in columns.values()
    ]
    return {
        "kind": "trial",
        "joint": joint,
        "gains": {register.name: raw for register, raw in after.gains.items()},
        "span_s": round(end_s, 2),
        "times": times.round(3).tolist(),
        "values": values,
        "series": [{"quantity": "step", "unit": "°", "joint": name} for name in columns],
    }


def _compared(trials: Sequence[Trial]) -> tuple[Trial, Trial]:
    """Return the trials of the present gains, and of the given or best found gains."""
    return trials[0], trials[1] if len(trials) == 2 else best_trial(trials)

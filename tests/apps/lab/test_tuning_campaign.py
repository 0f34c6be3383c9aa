"""Suggested gains compared with a search of the whole grid, on 20 simulated joints."""

from itertools import product

import numpy as np
import pytest

from ikservo.apps.workbench.gain_search import (
    Trial,
    gain_registers,
    keeping_gains,
    measure_response,
    search_gains,
    write_gains,
)
from ikservo.arm.opening import open_own_arm
from ikservo.errors import RefusedError
from ikservo.model import load_model
from tests.apps.lab.test_servo_tuning import STEP_RAD, servo_of

JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
P_FACTORS, D_FACTORS = (0.5, 0.7, 1.0, 1.4, 2.0, 2.8, 4.0), (0.5, 1.0, 2.0, 4.0)
RESOLUTION_RAD, RESOLUTION_S = np.radians(0.1), 0.02  # a tick, a control cycle
CASES = [(arm, 10 * i + j, JOINTS[j % 5]) for i, arm in enumerate(("so101", "koch"))
         for j in range(1, 11)]  # fmt: skip


@pytest.mark.campaign
@pytest.mark.timeout(3600)
@pytest.mark.parametrize(("arm_name", "seed", "joint"), CASES)
def test_suggested_gains_are_close_to_best_of_grid_search(arm_name, seed, joint):
    with open_own_arm(load_model(arm_name), f"sim:?pose=home&seed={seed}") as arm:
        servo, bus = servo_of(arm, joint), arm.context.servos.bus
        p_gain, d_gain = gain_registers(servo)
        with keeping_gains(bus, servo) as present:
            first = Trial(present, measure_response(arm, joint, STEP_RAD))
            trials = [first, *search_gains(arm, servo, first, STEP_RAD)]
            grid = []
            for p_factor, d_factor in product(P_FACTORS, D_FACTORS):
                usual = present[d_gain] or d_gain.range[1] // 8
                gains = {
                    p_gain: min(round(p_factor * present[p_gain]), p_gain.range[1]),
                    d_gain: min(round(d_factor * usual), d_gain.range[1]),
                }
                write_gains(bus, servo, gains)
                try:
                    grid.append(Trial(gains, measure_response(arm, joint, STEP_RAD)))
                except RefusedError:  # it lags so far that the guard stops it
                    write_gains(bus, servo, present)
                    arm.acknowledge()
    found = min(trials, key=lambda one: one.response.cost)
    best = min(grid, key=lambda one: one.response.cost)
    print(f"{arm_name} {seed} {joint}: found {summary(found)} in {len(trials)}; "  # noqa: T201
          f"best {summary(best)}; before {summary(first)}")  # fmt: skip
    assert not found.response.swings
    assert found.response.overshoot_rad <= 1.2 * best.response.overshoot_rad + RESOLUTION_RAD
    assert found.response.settling_s <= 1.2 * best.response.settling_s + RESOLUTION_S


def summary(trial):
    one = trial.response
    return (
        f"{list(trial.gains.values())} overshoot {np.degrees(one.overshoot_rad):.2f} settling "
        f"{one.settling_s:.2f} short {np.degrees(one.steady_error_rad):.2f}"
    )

"""Joints without load whose servos would swing on in their play rest after a motion, or are named.

The seeds are those of arms whose pan, with a friction of 0.001 to 0.002 N m on its output, swung by
22 ticks at rest after each of these motions.
"""

import numpy as np
import pytest

import ikservo
from tests.arm.simulated import clock_of, line_of

TICK_RAD = 2.0 * np.pi / 4096


@pytest.mark.full
@pytest.mark.parametrize("seed", [154, 188])
def test_a_pan_whose_servo_swings_by_itself_is_brought_to_rest(seed):
    with ikservo.open_arm("so101", port=f"sim:?seed={seed}&pose=home") as arm:
        pan, clock = line_of(arm).world.joint("shoulder_pan"), clock_of(arm)
        for goal_rad in (0.3, -0.1):
            report = arm.move_joints({"shoulder_pan": goal_rad}, speed="normal")
            clock.sleep_until(clock.now_s() + 1.0)
            seen = list[float]()
            for _ in range(50):
                clock.sleep_until(clock.now_s() + 0.02)
                arm.where()  # the simulated line follows its host
                seen.append(pan.position)
            assert np.ptp(seen) <= 2.0 * TICK_RAD
            assert abs(seen[-1] - goal_rad) < 4.0 * TICK_RAD
            assert not any("swings" in each for each in report.binding)

"""Joints that swing across their backlash come to rest after a motion, or are reported in it.

The seeds are those of arms whose pan, with a friction of 0.001 to 0.002 N m at its output, swung by
22 ticks after each of these motions.
"""

import numpy as np
import pytest

import ikservo
from ikservo.control.loop import ControlCycle
from ikservo.settling.swings import MotionSwings
from tests.arm.simulated import clock_of, line_of

TICK_RAD = 2.0 * np.pi / 4096


@pytest.mark.full
@pytest.mark.parametrize("seed", [154, 188])
def test_oscillating_shoulder_pan_is_damped_after_motion(seed):
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


@pytest.mark.full
def test_warning_names_oscillating_joint_and_its_amplitude():
    # Shoulder and elbow have 1.8° of play, no D gain, and the elbow 0.74 of its friction.
    with ikservo.open_arm("so101", port="sim:?seed=431&pose=home") as arm:
        arm.move_joints({"shoulder_lift": -0.3, "elbow_flex": -1.06, "wrist_flex": -0.67})
        elbow, off = line_of(arm).world.joint("elbow_flex"), list[float]()
        plan = arm.plan_joints({"shoulder_lift": -1.5, "elbow_flex": 0.6}, speed="normal")
        at = plan.names.index("elbow_flex")

        def watch(progress):
            reference = plan.trajectory.state(progress.elapsed_s).position[at]
            off.append(elbow.position - reference)

        report = arm.execute(plan, watch)
    assert np.ptp(off) > np.radians(1.8)
    assert any(each.startswith("elbow_flex swung by up to") for each in report.binding)


def test_lag_during_motion_is_not_reported_as_oscillation():
    with ikservo.open_arm("so101", port="sim:?pose=home") as arm:
        report = arm.move_joints({"shoulder_lift": -1.0, "elbow_flex": 0.6}, speed="normal")
    assert not any("swung" in each for each in report.binding)


@pytest.mark.parametrize(("ways", "named"), [(12, 0), (1, 1)])
def test_lag_at_reversal_is_not_counted_as_oscillation(ways, named):
    time_s = np.arange(0.0, 4.0, 0.01)
    there = 0.5 * np.abs((time_s * ways / 4.0) % 2.0 - 1.0)
    swing = 0.03 * np.sin(2.0 * np.pi * 5.0 * time_s) * (ways == 1)
    with ikservo.open_arm("so101", port="sim") as arm:
        driven = arm.context.servos.driven_joints
    swings, only = MotionSwings(driven), np.arange(len(driven)) == 0
    for now_s, goal, lagging in zip(
        time_s, there, np.interp(time_s - 0.1, time_s, there) + swing, strict=True
    ):
        reference, measured = goal * only, lagging * only
        swings.record(ControlCycle(now_s, 4.0, reference, reference, measured, ()))
    assert len(swings.notes()) == named

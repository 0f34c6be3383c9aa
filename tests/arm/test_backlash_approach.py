"""A joint with backlash in its arm file approaches its goal from one side."""

import re
import shutil

import numpy as np
import pytest

import ikservo
from tests.arm.simulated import clock_of, line_of, registers, servo_group, servo_id, true_joints
from tests.oracle import CONFIGS

PAN, ID = "shoulder_pan", servo_id("so101", "shoulder_pan")
PORT = "sim:?backlash_deg=0.5"


@pytest.fixture
def arm_file(tmp_path):
    """Return the SO-101's file with backlash in the joint that no weight loads."""
    folder = shutil.copytree(CONFIGS / "so101", tmp_path / "so101")
    text = (folder / "arm.toml").read_text()
    arm_text = re.sub(rf"(name *= \"{PAN}\")", r"\1\nbacklash_deg = 0.5", text, count=1)
    assert arm_text != text
    (folder / "arm.toml").write_text(arm_text)
    return folder


def flanks(arm):
    """Return the flank of the backlash at which the joint rests, after different approaches."""
    found = []
    for speed in ("slow", "fast"):
        for start in (-0.3, 0.3):
            arm.move_joints({PAN: start}, speed="fast")
            arm.move_joints({PAN: 0.1}, speed=speed)
            assert true_joints(arm)[PAN] == pytest.approx(0.1, abs=0.003)
            found.append(line_of(arm).servos[ID].motor.lash_rad > 0.0)
    return found


@pytest.mark.campaign
def test_unknown_backlash_lets_joint_rest_on_either_gear_flank():
    with ikservo.open_arm("so101", port=PORT) as arm:
        assert len(set(flanks(arm))) == 2


@pytest.mark.campaign
def test_known_backlash_makes_joint_rest_on_one_gear_flank(arm_file):
    with ikservo.open_arm(arm_file, port=PORT) as arm:
        assert set(flanks(arm)) == {False}


@pytest.mark.full
def test_backlash_approach_stays_inside_joint_limit(arm_file):
    with ikservo.open_arm(arm_file, port=PORT) as arm:
        lowest = servo_group(arm).driven_joints[0].position_range[0]
        report = arm.move_joints({PAN: lowest}, speed="fast")
        assert report.reached
        assert registers(arm, "goal_position")[ID] in range(
            *sorted(servo_group(arm).driven_joints[0].tick_range)
        )


@pytest.mark.campaign
def test_motion_report_duration_includes_backlash_approach(arm_file):
    with ikservo.open_arm(arm_file, port=PORT) as arm:
        arm.pose("home")
        before_s = clock_of(arm).now_s()
        arrival = arm.execute(arm.plan_joints({PAN: 0.2}, speed="fast"))
        took_s = clock_of(arm).now_s() - before_s
    assert arrival.duration_s == pytest.approx(took_s, rel=0.1)


@pytest.mark.full
def test_straight_line_ends_without_backlash_approach(arm_file):
    with ikservo.open_arm(arm_file, port=PORT) as arm:
        arm.pose("home")
        plan = arm.plan_line(np.add(arm.where().tip_m, (0.0, -0.03, 0.0)))
        servo, at_rad = line_of(arm).servos[ID], []
        servo.on_write = lambda *_: at_rad.append(servo.motor.position_rad)
        arm.execute(plan)
    ticks = np.array(at_rad) * 4096 / (2.0 * np.pi)
    assert plan.goal[0] > plan.start[0]
    assert (np.maximum.accumulate(ticks) - ticks).max() <= 2

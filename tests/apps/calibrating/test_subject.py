"""Facts about a joint that the calibration takes from the arm file alone."""

import math

import pytest

from ikservo.calibration import JointMap, Limits
from ikservo.calibration.uncalibrated_joint import JointUnderCalibration

TURN = 4096


def subject(lower, upper, pose=0.0, turn=TURN, sign=1):
    joint_map = JointMap.revolute("elbow", 3, sign, 2048, TURN)
    return JointUnderCalibration(
        joint_map, turn, Limits.of("elbow", lower, upper, "arm file"), pose
    )


@pytest.mark.parametrize(("pose", "towards"), [(0.5, 1), (0.51, -1), (0.49, 1)])
def test_free_direction_of_joint_is_towards_its_larger_range(pose, towards):
    assert subject(-1.0, 2.0, pose).free_direction == towards


@pytest.mark.parametrize("sign", [1, -1])
def test_expected_range_in_ticks_does_not_depend_on_sign(sign):
    assert subject(-math.pi / 2, math.pi, sign=sign).expected_ticks == pytest.approx(0.75 * TURN)


def test_joint_sign_needs_motion_of_15_deg_or_quarter_of_range():
    assert subject(-1.5, 1.5).min_motion_ticks == pytest.approx(15 / 360 * TURN)
    assert subject(0.0, math.pi / 4).min_motion_ticks == pytest.approx(TURN / 32)


def test_joint_sign_of_potentiometer_uses_its_tick_scale():
    assert subject(-1.5, 1.5, turn=0).min_motion_ticks == pytest.approx(15 / 360 * 1229)


@pytest.mark.parametrize("sign", [1, -1])
def test_zero_tick_follows_from_anchor_pose(sign):
    posed = subject(-1.5, 1.5, pose=math.pi / 4)
    assert posed.zero_tick(sign, 1000.0) == pytest.approx(1000.0 - sign * TURN / 8)
    assert posed.with_mounting(sign, 1000.0).position(1000.0) == pytest.approx(math.pi / 4)

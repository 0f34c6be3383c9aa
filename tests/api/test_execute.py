"""`Arm.execute` executes a plan of any kind and returns the report of that kind."""

import numpy as np
import pytest

import ikservo
from ikservo.arm import JointMoveResult, MoveResult
from tests.arm.simulated import registers, servo_group, true_tip_m

NEAR = (0.2, 0.03, 0.12)


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        machine.move_joints({"shoulder_pan": 0.0})
        yield machine


def test_execute_of_tip_plan_returns_move_result(arm):
    report = arm.execute(arm.plan_to(NEAR))
    assert isinstance(report, MoveResult)
    assert report.reached
    np.testing.assert_allclose(true_tip_m(arm), NEAR, atol=0.003)


def test_execute_of_joint_plan_reports_only_moved_joints(arm):
    report = arm.execute(arm.plan_joints({"shoulder_pan": 0.3, "wrist_roll": 0.2}))
    assert isinstance(report, JointMoveResult)
    assert report.reached
    assert set(report.goal_rad) == {"shoulder_pan", "wrist_roll"}
    assert report.measured_rad["shoulder_pan"] == pytest.approx(0.3, abs=0.01)


def test_execute_of_plan_of_zero_length_returns_at_once(arm):
    report = arm.execute(arm.plan_joints(servo_group(arm).reference()))
    assert (report.goal_rad, report.error_rad, report.reached) == ({}, 0.0, True)


def test_hold_enables_torque_and_is_refused_in_motion():
    with ikservo.open_arm("so101", port="sim") as limp:
        limp.hold()
        assert all(registers(limp, "torque_enable").values())
        with pytest.raises(ikservo.RefusedError, match="is moving"):
            limp.move_joints({"wrist_roll": 0.2}, on_progress=lambda _: limp.hold())


def test_unknown_arm_attribute_raises_attribute_error(arm):
    for owner in (ikservo, ikservo.arm, arm, arm.plan_to(NEAR)):
        with pytest.raises(AttributeError, match="no attribute 'wobble'"):
            owner.wobble  # noqa: B018

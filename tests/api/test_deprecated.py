"""Old names of `Arm` still work for one version: they warn, and do what the new name does."""

import numpy as np
import pytest

import ikservo
from ikservo.arm import JointMoveResult, MoveResult, Recording
from ikservo.arm.plan import NearLimit
from ikservo.arm.recording import RecordingHeader
from ikservo.arm.replay import ReplayResult
from tests.arm.simulated import registers, servo_group, true_tip_m

NEAR = (0.2, 0.03, 0.12)


@pytest.fixture
def arm():
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        machine.move_joints({"shoulder_pan": 0.0})
        yield machine


def test_a_plan_of_the_tip_is_executed_and_reported_as_one(arm):
    report = arm.execute(arm.plan_to(NEAR))
    assert isinstance(report, MoveResult)
    assert report.reached
    np.testing.assert_allclose(true_tip_m(arm), NEAR, atol=0.003)


def test_a_plan_of_joints_is_executed_and_reported_for_the_joints_that_it_moves(arm):
    report = arm.execute(arm.plan_joints({"shoulder_pan": 0.3, "wrist_roll": 0.2}))
    assert isinstance(report, JointMoveResult)
    assert report.reached
    assert set(report.goal_rad) == {"shoulder_pan", "wrist_roll"}
    assert report.measured_rad["shoulder_pan"] == pytest.approx(0.3, abs=0.01)


def test_a_plan_that_moves_no_joint_is_executed_at_once(arm):
    report = arm.execute(arm.plan_joints(servo_group(arm).reference()))
    assert (report.goal_rad, report.error_rad, report.reached) == ({}, 0.0, True)


def test_go_warns_and_executes(arm):
    with pytest.warns(DeprecationWarning, match="use Arm.execute") as warned:
        arrival = arm.go(arm.plan_joints({"shoulder_pan": 0.3}))
    assert warned[0].filename == __file__
    assert arrival.measured[0] == pytest.approx(0.3, abs=0.01)


def test_carry_out_warns_and_executes(arm):
    with pytest.warns(DeprecationWarning, match="use Arm.execute") as warned:
        report = arm.carry_out(arm.plan_to(NEAR))
    assert warned[0].filename == __file__
    assert isinstance(report, MoveResult)


def test_carry_out_still_takes_no_plan_of_joints(arm):
    plan = arm.plan_joints({"shoulder_pan": 0.3})
    with (
        pytest.warns(DeprecationWarning, match="execute"),
        pytest.raises(ikservo.InputError, match="joints"),
    ):
        arm.carry_out(plan)


def test_hold_is_enable():
    with ikservo.open_arm("so101", port="sim") as limp:
        limp.hold()
        assert all(registers(limp, "torque_enable").values())
        with pytest.raises(ikservo.RefusedError, match="is moving"):
            limp.move_joints({"wrist_roll": 0.2}, on_progress=lambda _: limp.hold())


@pytest.mark.parametrize(
    ("module", "old", "new"),
    [
        (ikservo, "LineError", "CartesianPathError"),
        (ikservo, "Plan", "MotionPlan"),
        (ikservo, "ServoRefusedError", "ServoRejectedError"),
        (ikservo, "Stance", "ToolOrientation"),
        (ikservo.arm, "Whereabouts", "ArmState"),
        (ikservo.arm, "MoveReport", "MoveResult"),
        (ikservo.arm, "Zeros", "ZeroSource"),
    ],
)
def test_an_old_public_name_warns_and_is_the_new_one(module, old, new):
    with pytest.warns(DeprecationWarning, match=f"use {module.__name__}.{new}") as warned:
        found = getattr(module, old)
    assert found is getattr(module, new)
    assert warned[0].filename == __file__


def test_an_old_field_of_a_plan_warns_and_is_the_new_one(arm):
    plan = arm.plan_to(NEAR)
    for old, new in (("course", "trajectory"), ("near", "near_limits")):
        with pytest.warns(DeprecationWarning, match=f"use MotionPlan.{new}") as warned:
            assert getattr(plan, old) is getattr(plan, new)
        assert warned[0].filename == __file__


@pytest.mark.parametrize(
    ("value", "old", "new"),
    [
        (NearLimit("elbow_flex", "upper", 0.1, "rad"), "room", "margin"),
        (Recording(RecordingHeader("so101", (), (), 0.02), (), ()), "heading", "header"),
        (ReplayResult(1, 2.0, 1.5, 0.0, {}, ()), "slower", "slowdown"),
    ],
)
def test_an_old_field_of_a_result_warns_and_is_the_new_one(value, old, new):
    with pytest.warns(DeprecationWarning, match=f"use {type(value).__name__}.{new}") as warned:
        assert getattr(value, old) == getattr(value, new)
    assert warned[0].filename == __file__


def test_what_was_never_a_name_is_none(arm):
    for owner in (ikservo, ikservo.arm, arm, arm.plan_to(NEAR)):
        with pytest.raises(AttributeError, match="no attribute 'wobble'"):
            owner.wobble  # noqa: B018


@pytest.mark.parametrize(("old", "new"), [("release", "disable_torque"), ("glimpse", "last_state")])
def test_an_old_method_of_an_arm_warns_and_is_the_new_one(arm, old, new):
    with pytest.warns(DeprecationWarning, match=f"use Arm.{new}") as warned:
        assert getattr(arm, old) == getattr(arm, new)
    assert warned[0].filename == __file__

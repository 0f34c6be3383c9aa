"""Orientations of the tool that an arm can reach, and the error for those that it cannot."""

import numpy as np
import pytest

import ikservo
from ikservo.kinematics.se3 import exp_so3, log_so3
from tests.oracle import arm_file


@pytest.fixture(scope="module")
def six():
    with ikservo.open_arm("wx250s", port="sim:?pose=home") as machine:
        machine.enable()
        yield machine


@pytest.fixture(scope="module")
def five():
    with ikservo.open_arm("so101", port="sim:?pose=home") as machine:
        machine.enable()
        yield machine


def turned_by(arm, plan, R):
    """Return the angle between the tool at a plan's goal and R, rad."""
    reached = arm.chain.forward(plan.goal[: arm.chain.dof])[:3, :3]
    return float(np.linalg.norm(log_so3(R @ reached.T)))


@pytest.mark.full
def test_six_joint_arm_reaches_full_orientation(six):
    here = six.where()
    wanted = exp_so3(np.array([0.0, 0.3, 0.2])) @ here.orientation
    report = six.move_to(here.tip_m + np.array([0.0, 0.05, 0.03]), orientation=wanted)
    assert report.reached
    assert np.linalg.norm(log_so3(wanted @ six.where().orientation.T)) < np.radians(1.0)


def test_line_plan_ends_with_requested_orientation(six):
    here = six.where()
    wanted = exp_so3(np.array([0.0, 0.1, 0.0])) @ here.orientation
    plan = six.plan_line(here.tip_m + np.array([0.0, 0.0, 0.04]), orientation=wanted)
    assert turned_by(six, plan, wanted) < np.radians(0.5)


def test_five_joint_arm_reaches_attainable_orientation(five):
    q = five.chain.clip(five.where().positions_rad[:5] + np.array([0.2, 0.05, -0.05, 0.1, 0.3]))
    T = five.chain.forward(q)
    plan = five.plan_to(T[:3, 3], orientation=T[:3, :3])
    assert turned_by(five, plan, T[:3, :3]) < np.radians(0.5)


def test_five_joint_arm_refuses_unattainable_orientation(five):
    here = five.where()
    wanted = exp_so3(np.array([0.0, 0.0, 0.7])) @ here.orientation
    with pytest.raises(ikservo.OrientationError, match="5 joints") as caught:
        five.move_to(here.tip_m, orientation=wanted)
    assert "direction or a pitch" in caught.value.hint
    assert caught.value.left_rad > np.radians(0.5)
    assert len(arm_file("so101")["joints"]) - 1 == 5


def test_unreachable_pitch_error_does_not_blame_missing_joint(five):
    with pytest.raises(ikservo.OrientationError) as caught:
        five.plan_to((0.40, 0.0, 0.20), stance=ikservo.ToolOrientation(pitch_rad=-1.5))
    assert caught.value.freedom == ""


@pytest.mark.parametrize(
    "orientation", [np.eye(4), 2.0 * np.eye(3), -np.eye(3), "up", np.full((3, 3), np.nan)]
)
def test_orientation_that_is_not_a_rotation_is_refused(five, orientation):
    with pytest.raises(ikservo.BadValueError, match="orientation"):
        five.move_to((0.23, 0.02, 0.10), orientation=orientation)


def test_orientation_and_stance_arguments_together_are_refused(five):
    with pytest.raises(ikservo.BadValueError, match="given twice"):
        five.plan_to(
            (0.23, 0, 0.1), orientation=np.eye(3), stance=ikservo.ToolOrientation(keep=True)
        )

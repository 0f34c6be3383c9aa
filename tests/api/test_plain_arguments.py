"""Methods accept arm names and plain numbers, and errors name the wrong argument."""

import math

import numpy as np
import pytest

import ikservo
from ikservo.errors import BadValueError, RefusedError
from ikservo.model.catalogue import find_arm

POINT_M = (0.25, 0.05, 0.15)


@pytest.mark.parametrize("arm", ["so101", find_arm("so101"), ikservo.load_model("so101")])
def test_solve_accepts_arm_name_file_or_model(arm):
    assert ikservo.solve(arm, POINT_M).reached


@pytest.mark.parametrize("arm", [3, None, {}])
def test_solve_refuses_value_that_is_not_an_arm(arm):
    with pytest.raises(BadValueError, match="The arm is"):
        ikservo.solve(arm, POINT_M)


def test_solve_given_a_model_starts_from_home_pose():
    model = ikservo.load_model("so101")
    from_home = ikservo.solve(model.chain, ikservo.Target(POINT_M), model.chain_pose("home"))
    np.testing.assert_array_equal(ikservo.solve(model, POINT_M).q, from_home.q)


@pytest.mark.parametrize("goal", [{"elbow_flex": 50}, {"gripper": 0.3, "wrist_flex": -45}])
def test_joint_goal_in_degrees_is_refused_with_radians_in_hint(goal):
    degrees = list(goal.values())[-1]
    with (
        ikservo.open_arm("so101", port="sim") as arm,
        pytest.raises(RefusedError, match=rf"Did you mean {degrees} degrees") as caught,
    ):
        arm.move_joints(goal)
    assert f"math.radians({degrees}), which is {math.radians(degrees):.4g}" in caught.value.hint


@pytest.mark.parametrize("goal_rad", [300, math.radians(900)])
def test_degree_hint_is_omitted_if_goal_is_invalid_in_degrees(goal_rad):
    with ikservo.open_arm("so101", port="sim") as arm, pytest.raises(RefusedError) as caught:
        arm.move_joints({"elbow_flex": goal_rad})
    assert "degrees" not in caught.value.hint

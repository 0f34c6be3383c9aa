"""A folded arm rises to a pose where it is free, and continues from there."""

import math

import numpy as np
import pytest

import ikservo
from ikservo.errors import RefusedError
from tests.arm.simulated import clock_of, line_of, registers, true_tip_m

TARGET_M = (0.25, 0.05, 0.15)


@pytest.fixture
def folded():
    """Return an arm that has sunk onto itself under its own weight.

    Its wrist is placed: friction of 0.21 N m holds the tool, which weighs less.
    """
    with ikservo.open_arm("so101", port="sim") as arm:
        world = line_of(arm).world
        world._contacts = None
        for joint, degrees in {"shoulder_lift": -101, "elbow_flex": 98, "wrist_flex": 95}.items():
            world.place(joint, math.radians(degrees))
        clock_of(arm).sleep_until(world.time_s + 5.0)
        yield arm


@pytest.mark.full
def test_folded_arm_reaches_target_via_retract_pose(folded):
    plan = folded.plan_to(TARGET_M)
    assert plan.via_pose
    assert folded.execute(plan).reached
    np.testing.assert_allclose(true_tip_m(folded), TARGET_M, atol=2e-3)


def test_plan_via_retract_pose_contains_both_motions(folded):
    plan, first = folded.plan_to(TARGET_M), folded.plan_joints(folded.model.pose("home"))
    assert plan.duration_s > first.duration_s
    assert plan.path_m > first.path_m
    np.testing.assert_allclose(plan.start, first.start)
    np.testing.assert_allclose(plan.trajectory.state(0.0).position, plan.start)


@pytest.mark.campaign
def test_plan_of_collision_free_arm_does_not_use_retract_pose(folded):
    folded.pose("home")
    with pytest.raises(RefusedError, match="would touch the table"):
        folded.move_joints({"shoulder_lift": 1.5, "elbow_flex": 0.0, "wrist_flex": 0.0})
    assert folded.plan_to(TARGET_M).via_pose == ""


@pytest.mark.full
def test_folded_arm_refuses_target_in_collision(folded):
    before = registers(folded, "goal_position")
    with pytest.raises(RefusedError, match="would touch"):
        folded.move_to((0.25, 0.0, -0.05))
    assert registers(folded, "goal_position") == before

"""A joint past a limit returns before a jog, a gripper motion or hand guiding."""

import math
from dataclasses import replace

import numpy as np
import pytest

import ikservo
from ikservo.apps.teaching.hand_guiding import guide_by_hand
from ikservo.errors import RefusedError
from tests.arm.simulated import clock_of, context_of, line_of, registers

LIMIT_RAD = math.radians(10.0)


def open_past_limit(name, degrees):
    """Open a limp arm whose first joint is ``degrees`` past its limit of 10°."""
    model = ikservo.load_model(name)
    lower, upper = model.chain.lower_rad.copy(), model.chain.upper_rad.copy()
    lower[0], upper[0] = -LIMIT_RAD, LIMIT_RAD
    first, limits = model.joints[0], model.joints[0].limits
    own = replace(
        limits,
        lower=replace(limits.lower, value=-LIMIT_RAD),
        upper=replace(limits.upper, value=LIMIT_RAD),
    )
    narrowed = replace(
        model,
        chain=model.chain.with_limits(lower, upper),
        joints=(replace(first, limits=own), *model.joints[1:]),
    )
    arm = ikservo.open_arm(narrowed, port="sim:?pose=home")
    line_of(arm).world.place(arm.joint_names[0], LIMIT_RAD + math.radians(degrees))
    clock_of(arm).sleep_until(clock_of(arm).now_s() + 1.0)
    return arm


def add_box_in_the_way_back(arm):
    """Add a box that the gripper touches on its way back, but not at its present position."""
    start, tip_m = np.array(list(arm.where().positions.values())), arm.where().tip_m
    goal = np.clip(start, *arm.limits())
    for y_m in np.arange(-0.1, 0.0, 0.001):
        centre_m = tip_m + np.array([0.0, y_m, 0.0])
        arm.scene.add("box", "post", centre_m=centre_m, size_m=(0.04, 0.02, 0.02))
        if gap_to_post_m(arm, goal) < -0.001 and gap_to_post_m(arm, start) > 0.0:
            return
        arm.scene.remove("post")
    raise AssertionError("no box is in the way")


def gap_to_post_m(arm, joints):
    checker = context_of(arm).collision
    gaps_m = checker.distances([context_of(arm).index.body_joints(joints)])[0]
    return min(gaps_m[i] for i, (_, thing) in enumerate(checker.pairs) if thing == "post")


def pan_deg(arm):
    return math.degrees(line_of(arm).world.joint(arm.joint_names[0]).position)


def jog_last_joint(arm):
    answers = iter([True] * 5)
    arm.jog(arm.joint_names[-2], wanted=lambda: next(answers, False))


def guide_briefly(arm):
    answers = iter([False] * 5)
    guide_by_hand(arm, lambda: next(answers, True))


def open_gripper(arm):
    arm.gripper("open")


MOTIONS = (open_gripper, jog_last_joint, guide_briefly)


@pytest.mark.full
@pytest.mark.parametrize("name", ["koch", "so101", "wx250s"])
def test_joint_far_outside_limits_needs_explicit_pose_command(name):
    with open_past_limit(name, 70.0) as arm:
        before, goals = pan_deg(arm), registers(arm, "goal_position")
        for move in MOTIONS:
            with pytest.raises(RefusedError, match=arm.joint_names[0]) as refused:
                move(arm)
            assert 'arm.pose("home")' in refused.value.hint
        assert registers(arm, "goal_position") == goals
        assert pan_deg(arm) == pytest.approx(before, abs=0.1)
        arm.pose("home")
        jog_last_joint(arm)
        assert pan_deg(arm) == pytest.approx(0.0, abs=1.0)


@pytest.mark.full
def test_path_back_inside_limits_is_refused_if_it_collides():
    with open_past_limit("koch", 4.0) as arm:
        add_box_in_the_way_back(arm)
        before = pan_deg(arm)
        for move in MOTIONS:
            with pytest.raises(RefusedError, match="on its path back"):
                move(arm)
        assert pan_deg(arm) == pytest.approx(before, abs=0.1)
        arm.scene.remove("post")
        jog_last_joint(arm)
        assert pan_deg(arm) == pytest.approx(10.0, abs=0.5)

"""A plan lists the joints that come near a limit, closest first."""

import math

import numpy as np

from ikservo.planning.motion_plan import near_limits

LOWER, UPPER = np.radians([-100.0, -100.0, -np.inf]), np.radians([100.0, 100.0, np.inf])


def test_plan_lists_joints_within_5_deg_of_limit():
    joints = np.radians([[0.0, 0.0, 720.0], [-96.0, 98.0, 0.0], [0.0, 0.0, 0.0]])
    near = near_limits(joints, LOWER, UPPER, ["a", "b", "c"], ["rad"] * 3)
    assert [(each.joint, each.side) for each in near] == [("b", "upper"), ("a", "lower")]
    assert math.isclose(near[0].margin, math.radians(2.0))


def test_plan_omits_joint_more_than_5_deg_from_limit():
    joints = np.radians([[94.0, 0.0, 0.0]])  # 6°: within a twentieth of the range, not within 5°
    assert near_limits(joints, LOWER, UPPER, ["a", "b", "c"], ["rad"] * 3) == ()


def test_plan_lists_sliding_joint_within_5_mm_of_limit():
    near = near_limits(np.array([[0.004], [0.1]]), np.zeros(1), np.array([0.2]), ["s"], ["m"])
    assert [(each.joint, each.side, each.unit) for each in near] == [("s", "lower", "m")]

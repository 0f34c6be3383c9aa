"""Chains of every kind of joint, asked for one q and for many."""

import math

import numpy as np
import pytest

from ikservo.errors import BadValueError, InputError, UnknownNameError
from ikservo.kinematics import Chain, JointType, Mimic, distance_to_limits, manipulability
from tests.kinematics.chains import crane, joint, planar

Q = np.random.default_rng(2).uniform(-1.0, 1.0, (7, 3))
ARM = planar(0.3, 0.2, 0.1)


def wheel():
    """Return a continuous joint with a finger on it."""
    return Chain.from_joints(
        [
            joint("spin", JointType.REVOLUTE, "base", "wheel"),
            joint("slide", JointType.PRISMATIC, "wheel", "tip", (0.1, 0, 0), (1, 0, 0),
                  lower=0.0, upper=0.2),
        ],
        "base",
        "tip",
    )  # fmt: skip


def follower(lower, upper, multiplier):
    return Chain.from_joints(
        [
            joint("a", JointType.REVOLUTE, "base", "l1", lower=-1.0, upper=1.0),
            joint("b", JointType.REVOLUTE, "l1", "tip", (0.1, 0, 0), lower=lower, upper=upper,
                  mimic=Mimic("a", multiplier, 0.1)),
        ],
        "base",
        "tip",
    )  # fmt: skip


def test_many_poses_are_those_of_every_q_alone():
    np.testing.assert_allclose(ARM.forward(Q), [ARM.forward(q) for q in Q], atol=1e-15)


def test_many_jacobians_are_those_of_every_q_alone():
    offset_m = (0.01, 0.02, 0.03)
    one_by_one = [ARM.jacobian(q, "l2", offset_m) for q in Q]
    np.testing.assert_allclose(ARM.jacobian(Q, "l2", offset_m), one_by_one, atol=1e-15)


def test_many_jacobians_of_slides_are_those_of_every_q_alone():
    q = [[0.3, 0.1], [-1.0, 0.4], [0.0, 0.0]]
    np.testing.assert_allclose(crane().jacobian(q), [crane().jacobian(each) for each in q])


def test_what_follows_a_joint_that_is_held_stands_where_that_puts_it():
    joints = [
        joint("arm", JointType.REVOLUTE, "base", "hand"),
        joint("jaw", JointType.PRISMATIC, "hand", "left", (0, 0, 0), (0, 1, 0), lower=0.02,
              upper=0.05),
        joint("other", JointType.PRISMATIC, "hand", "right", (0, 0, 0), (0, 1, 0),
              mimic=Mimic("jaw", -1.5, 0.01)),
    ]  # fmt: skip
    chain = Chain.from_joints(joints, "base", "hand")
    assert chain.forward([0.0], "left")[1, 3] == pytest.approx(0.02)
    assert chain.forward([0.0], "right")[1, 3] == pytest.approx(-1.5 * 0.02 + 0.01)


def test_a_follower_may_leave_its_leader_a_single_value():
    chain = follower(1.1, 4.0, 1.0)
    assert (chain.lower_rad[0], chain.upper_rad[0]) == (1.0, 1.0)


def test_the_poses_of_all_links_are_those_of_every_link_alone():
    q = [[0.3, 0.1], [-1.0, 0.4]]
    for frame, poses in crane().link_poses(q).items():
        np.testing.assert_allclose(poses, crane().forward(q, frame), atol=1e-15)


def test_a_continuous_joint_has_no_limits():
    turned, many_turns_on = wheel().forward([[0.3, 0.0], [0.3 + 32 * math.pi, 0.0]])
    assert wheel().lower_rad[0] == -math.inf
    np.testing.assert_allclose(turned, many_turns_on, atol=1e-12)


def test_a_continuous_joint_stays_so_when_the_limits_of_others_are_narrowed():
    narrow = wheel().with_limits([-math.inf, 0.1], [math.inf, 0.15])
    assert narrow.upper_rad.tolist() == [math.inf, 0.15]


def test_a_limited_joint_cannot_be_made_continuous():
    with pytest.raises(BadValueError, match="upper limits"):
        wheel().with_limits([-math.inf, 0.0], [math.inf, math.inf])


def test_what_follows_a_joint_narrows_its_limits():
    chain = follower(-0.4, 0.9, -2.0)
    np.testing.assert_allclose([chain.lower_rad[0], chain.upper_rad[0]], [-0.4, 0.25])


def test_a_follower_of_which_no_more_is_said_goes_along_one_to_one():
    joints = [
        joint("a", JointType.REVOLUTE, "base", "l1"),
        joint("b", JointType.REVOLUTE, "l1", "tip", mimic=Mimic("a")),
    ]
    turned = Chain.from_joints(joints, "base", "tip").forward([0.3])
    assert math.atan2(turned[1, 0], turned[0, 0]) == pytest.approx(0.6)


def test_a_follower_that_leaves_its_leader_no_value_is_refused():
    with pytest.raises(InputError, match="a has no value"):
        follower(3.0, 4.0, 1.0)


def test_a_mimic_of_no_joint_is_refused():
    first = joint("a", JointType.REVOLUTE, "base", "l1")
    lost = joint("b", JointType.REVOLUTE, "l1", "tip", mimic=Mimic("nobody"))
    with pytest.raises(UnknownNameError, match="nobody"):
        Chain.from_joints([first, lost], "base", "tip")


@pytest.mark.parametrize("q", [np.zeros((2, 2)), np.zeros((1, 1, 3)), [[0, 0, math.nan]]])
def test_many_q_of_a_wrong_shape_or_not_finite_are_refused(q):
    with pytest.raises(BadValueError, match="q is"):
        ARM.forward(q)


def test_a_stretched_arm_cannot_move_along_itself():
    rows = ARM.jacobian([[0, 0, 0], [0, 1, 1]])[:, :2, :]
    stretched, bent = manipulability(rows)
    assert stretched == pytest.approx(0.0, abs=1e-12)
    assert bent > 0.01
    assert manipulability(rows[1]) == pytest.approx(bent)


def test_the_room_to_the_nearer_limit_is_negative_outside():
    arm = planar(0.3, 0.2).with_limits([-1, 0], [1, 2])
    np.testing.assert_allclose(distance_to_limits(arm, [0.8, 2.5]), [0.2, -0.5])

"""Chains with every kind of joint, evaluated for one q and for many."""

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


def test_batch_forward_kinematics_equals_single_results():
    np.testing.assert_allclose(ARM.forward(Q), [ARM.forward(q) for q in Q], atol=1e-15)


def test_batch_jacobians_equal_single_jacobians():
    offset_m = (0.01, 0.02, 0.03)
    one_by_one = [ARM.jacobian(q, "l2", offset_m) for q in Q]
    np.testing.assert_allclose(ARM.jacobian(Q, "l2", offset_m), one_by_one, atol=1e-15)


def test_batch_jacobians_of_prismatic_chain_equal_single_ones():
    q = [[0.3, 0.1], [-1.0, 0.4], [0.0, 0.0]]
    np.testing.assert_allclose(crane().jacobian(q), [crane().jacobian(each) for each in q])


def test_mimic_of_fixed_leader_is_at_ratio_of_its_position():
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


def test_mimic_limits_may_leave_leader_single_value():
    chain = follower(1.1, 4.0, 1.0)
    assert (chain.lower_rad[0], chain.upper_rad[0]) == (1.0, 1.0)


def test_link_poses_equal_forward_kinematics_of_each_link():
    q = [[0.3, 0.1], [-1.0, 0.4]]
    for frame, poses in crane().link_poses(q).items():
        np.testing.assert_allclose(poses, crane().forward(q, frame), atol=1e-15)


def test_continuous_joint_has_no_limits():
    turned, many_turns_on = wheel().forward([[0.3, 0.0], [0.3 + 32 * math.pi, 0.0]])
    assert wheel().lower_rad[0] == -math.inf
    np.testing.assert_allclose(turned, many_turns_on, atol=1e-12)


def test_continuous_joint_stays_continuous_with_other_limits():
    narrow = wheel().with_limits([-math.inf, 0.1], [math.inf, 0.15])
    assert narrow.upper_rad.tolist() == [math.inf, 0.15]


def test_limited_joint_cannot_become_continuous():
    with pytest.raises(BadValueError, match="upper limits"):
        wheel().with_limits([-math.inf, 0.0], [math.inf, math.inf])


def test_mimic_joint_narrows_limits_of_its_leader():
    chain = follower(-0.4, 0.9, -2.0)
    np.testing.assert_allclose([chain.lower_rad[0], chain.upper_rad[0]], [-0.4, 0.25])


def test_mimic_without_ratio_follows_one_to_one():
    joints = [
        joint("a", JointType.REVOLUTE, "base", "l1"),
        joint("b", JointType.REVOLUTE, "l1", "tip", mimic=Mimic("a")),
    ]
    turned = Chain.from_joints(joints, "base", "tip").forward([0.3])
    assert math.atan2(turned[1, 0], turned[0, 0]) == pytest.approx(0.6)


def test_mimic_limits_that_leave_no_leader_position_are_refused():
    with pytest.raises(InputError, match="a has no position"):
        follower(3.0, 4.0, 1.0)


def test_mimic_of_unknown_joint_is_refused():
    first = joint("a", JointType.REVOLUTE, "base", "l1")
    lost = joint("b", JointType.REVOLUTE, "l1", "tip", mimic=Mimic("nobody"))
    with pytest.raises(UnknownNameError, match="nobody"):
        Chain.from_joints([first, lost], "base", "tip")


@pytest.mark.parametrize("q", [np.zeros((2, 2)), np.zeros((1, 1, 3)), [[0, 0, math.nan]]])
def test_joint_array_of_wrong_shape_or_nan_is_refused(q):
    with pytest.raises(BadValueError, match="q is"):
        ARM.forward(q)


def test_manipulability_of_stretched_arm_is_zero():
    rows = ARM.jacobian([[0, 0, 0], [0, 1, 1]])[:, :2, :]
    stretched, bent = manipulability(rows)
    assert stretched == pytest.approx(0.0, abs=1e-12)
    assert bent > 0.01
    assert manipulability(rows[1]) == pytest.approx(bent)


def test_distance_to_joint_limits_is_negative_outside():
    arm = planar(0.3, 0.2).with_limits([-1, 0], [1, 2])
    np.testing.assert_allclose(distance_to_limits(arm, [0.8, 2.5]), [0.2, -0.5])

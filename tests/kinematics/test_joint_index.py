"""Columns of vectors of all joints: the chain's, the collision body's, and those beside."""

import numpy as np
import pytest

from ikservo.errors import UnknownNameError
from ikservo.kinematics import JointIndex

NAMES = ("jaw", "pan", "lift", "mirror")
INDEX = JointIndex.from_names(NAMES, ("pan", "lift"), gripper="jaw")
JOINTS = np.array([0.1, 0.2, 0.3, 0.4])


def test_the_body_moves_with_the_chain_and_then_with_the_gripper():
    assert JointIndex(NAMES, chain=(1, 2), body=(1, 2, 0)) == INDEX
    assert JointIndex.from_names(NAMES, ("lift", "pan")) == JointIndex(NAMES, (2, 1), (2, 1))


def test_a_chain_of_other_joints_has_no_columns():
    with pytest.raises(ValueError, match="not in tuple"):
        JointIndex.from_names(NAMES, ("elbow",))


def test_a_joint_is_found_by_its_name():
    assert [INDEX.column(name) for name in NAMES] == [0, 1, 2, 3]
    with pytest.raises(UnknownNameError, match="lft"):
        INDEX.column("lft")


def test_columns_are_taken_of_one_vector_and_of_many():
    assert INDEX.chain_joints(JOINTS).tolist() == [0.2, 0.3]
    assert INDEX.body_joints(JOINTS).tolist() == [0.2, 0.3, 0.1]
    assert INDEX.chain_joints(np.array([JOINTS, -JOINTS])).tolist() == [[0.2, 0.3], [-0.2, -0.3]]
    assert INDEX.body_joints(np.array([JOINTS])).tolist() == [[0.2, 0.3, 0.1]]


def test_replaced_positions_leave_the_others_and_the_original():
    assert INDEX.with_chain(JOINTS, np.array([1.0, 2.0])).tolist() == [0.1, 1.0, 2.0, 0.4]
    assert INDEX.with_position(JOINTS, "mirror", 3.0).tolist() == [0.1, 0.2, 0.3, 3.0]
    assert JOINTS.tolist() == [0.1, 0.2, 0.3, 0.4]


def test_positions_are_named():
    assert INDEX.by_name(JOINTS) == {"jaw": 0.1, "pan": 0.2, "lift": 0.3, "mirror": 0.4}


def test_joints_beside_the_chain_are_marked():
    assert INDEX.outside_chain().tolist() == [True, False, False, True]

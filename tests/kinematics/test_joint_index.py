"""Columns of vectors of all joints: the chain's, the collision body's, and the others."""

import numpy as np
import pytest

from ikservo.errors import UnknownNameError
from ikservo.kinematics import JointIndex

NAMES = ("jaw", "pan", "lift", "mirror")
INDEX = JointIndex.from_names(NAMES, ("pan", "lift"), gripper="jaw")
JOINTS = np.array([0.1, 0.2, 0.3, 0.4])


def test_joint_index_lists_chain_joints_then_gripper():
    assert JointIndex(NAMES, chain=(1, 2), body=(1, 2, 0)) == INDEX
    assert JointIndex.from_names(NAMES, ("lift", "pan")) == JointIndex(NAMES, (2, 1), (2, 1))


def test_joint_index_of_unknown_chain_is_refused():
    with pytest.raises(ValueError, match="not in tuple"):
        JointIndex.from_names(NAMES, ("elbow",))


def test_joint_index_finds_column_by_name():
    assert [INDEX.column(name) for name in NAMES] == [0, 1, 2, 3]
    with pytest.raises(UnknownNameError, match="lft"):
        INDEX.column("lft")


def test_joint_index_selects_columns_of_one_or_many_vectors():
    assert INDEX.chain_joints(JOINTS).tolist() == [0.2, 0.3]
    assert INDEX.body_joints(JOINTS).tolist() == [0.2, 0.3, 0.1]
    assert INDEX.chain_joints(np.array([JOINTS, -JOINTS])).tolist() == [[0.2, 0.3], [-0.2, -0.3]]
    assert INDEX.body_joints(np.array([JOINTS])).tolist() == [[0.2, 0.3, 0.1]]


def test_joint_vector_updates_do_not_change_input():
    assert INDEX.with_chain(JOINTS, np.array([1.0, 2.0])).tolist() == [0.1, 1.0, 2.0, 0.4]
    assert INDEX.with_position(JOINTS, "mirror", 3.0).tolist() == [0.1, 0.2, 0.3, 3.0]
    assert JOINTS.tolist() == [0.1, 0.2, 0.3, 0.4]


def test_joint_index_maps_joint_names_to_positions():
    assert INDEX.by_name(JOINTS) == {"jaw": 0.1, "pan": 0.2, "lift": 0.3, "mirror": 0.4}


def test_joint_index_marks_joints_outside_chain():
    assert INDEX.outside_chain().tolist() == [True, False, False, True]

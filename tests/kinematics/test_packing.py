"""An arm as numbers for compiled code equals the chain."""

import math

import numpy as np
import pytest

from ikservo.kinematics import Chain, JointType, Mimic, pack_chain
from ikservo.kinematics.capsules import Capsule
from ikservo.kinematics.packed import (
    AXIS,
    COLUMN,
    DOF,
    END,
    FIRST_INDEPENDENT,
    FULL_TURN,
    IS_ALIGNED,
    IS_PRISMATIC,
    IS_REVOLUTE,
    LINK,
    LINK_POSE,
    LOWER,
    MIMIC_COLUMN,
    MIMIC_OFFSET,
    MIMIC_SCALE,
    ORIGIN,
    PARENT,
    POSITION,
    RADIUS,
    ROTATION,
    SCALE,
    SHIFT,
    START,
    STEPS,
    UPPER,
    WIDTH,
    pack_capsules,
    pack_links,
    rotation_z_to,
)
from ikservo.kinematics.se3 import make_pose
from tests.kinematics.chains import crane, joint, planar


def unpacked(packed, q):
    """Return the pose that the rows give: z is the axis of every joint."""
    T = np.eye(4)
    steps = int(packed[0, STEPS])
    for row in packed[1 : 1 + steps]:
        value = row[SCALE] * q[int(row[COLUMN])] + row[SHIFT]
        T = T @ placed(row)
        c, s = math.cos(value), math.sin(value)
        turned = make_pose(np.zeros(3), [[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        T = T @ (turned if row[IS_REVOLUTE] else make_pose([0.0, 0.0, value]))
    return T @ placed(packed[1 + steps])


def placed(row):
    return make_pose(row[POSITION : POSITION + 3], row[ROTATION : ROTATION + 9].reshape(3, 3))


@pytest.mark.parametrize("frame", [None, "cart", "lever", "base"])
def test_packed_chain_pose_equals_forward_kinematics(frame):
    chain, q, offset_m = crane(), np.array([0.7, 0.2]), np.array([0.01, -0.02, 0.03])
    packed = pack_chain(chain, frame, offset_m)
    np.testing.assert_allclose(unpacked(packed, q), chain.forward(q, frame, offset_m), atol=1e-14)


def test_packed_header_counts_joint_rows_and_limits():
    packed = pack_chain(crane())
    assert packed.shape == (2 + 3 + 2, WIDTH)
    assert (packed[0, STEPS], packed[0, DOF]) == (3.0, 2.0)
    assert pack_chain(crane(), "base").shape == (2 + 0 + 2, WIDTH)


def test_packed_chain_has_rows_only_for_moving_joints():
    assert pack_chain(planar(0.3, 0.2)).shape == (2 + 2 + 2, WIDTH)
    assert pack_chain(crane(), "lever").shape == (2 + 1 + 2, WIDTH)


@pytest.mark.parametrize(
    "axis",
    [(1.0, 0.0, 0.0), (-1.0, 0.0, 0.0), (0.0, -1.0, 0.0), (0.6, 0.0, 0.8), (-0.95, 0.3, 0.1)],
)
def test_packed_tool_z_axis_is_tool_axis(axis):
    axis = np.array(axis) / np.linalg.norm(axis)
    chain, q = planar(0.3, 0.2), np.array([0.4, -0.9])
    found = unpacked(pack_chain(chain, tool_axis=axis), q)
    np.testing.assert_allclose(found[:3, 2], chain.forward(q)[:3, :3] @ axis, atol=1e-14)
    np.testing.assert_allclose(found[:3, 3], chain.forward(q)[:3, 3], atol=1e-14)
    R = rotation_z_to(axis)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0)


def one_joint(mimic=False, **more):
    """Return a joint, and optionally another one that follows it, before a tip."""
    joints = [joint("a", more.pop("kind", JointType.REVOLUTE), "base", "l1", **more)]
    if mimic:
        joints.append(joint("b", JointType.REVOLUTE, "l1", "l2", mimic=Mimic("a")))
    return Chain.from_joints(joints, "base", "l1")


def test_packed_first_joint_is_independent_if_plain_revolute():
    assert pack_chain(one_joint())[0, FIRST_INDEPENDENT] == 1.0
    assert pack_chain(crane())[0, FIRST_INDEPENDENT] == 1.0
    assert pack_chain(one_joint(mimic=True))[0, FIRST_INDEPENDENT] == 0.0
    assert pack_chain(one_joint(kind=JointType.PRISMATIC))[0, FIRST_INDEPENDENT] == 0.0
    assert pack_chain(crane(), "base")[0, FIRST_INDEPENDENT] == 0.0


@pytest.mark.parametrize(("multiplier", "offset"), [(0.5, 0.0), (1.0, 0.3)])
def test_packed_first_joint_that_is_mimic_is_not_independent(multiplier, offset):
    joints = [
        joint("first", JointType.REVOLUTE, "base", "l1", mimic=Mimic("second", multiplier, offset)),
        joint("second", JointType.REVOLUTE, "l1", "tip", (0.1, 0, 0)),
    ]
    assert pack_chain(Chain.from_joints(joints, "base", "tip"))[0, FIRST_INDEPENDENT] == 0.0


@pytest.mark.parametrize(
    ("chain", "full"),
    [
        (one_joint(), 1.0),
        (one_joint(lower=-3.14, upper=3.14), 1.0),
        (one_joint(lower=0.0, upper=math.tau - 0.0099), 1.0),
        (one_joint(lower=0.0, upper=math.tau - 0.0101), 0.0),
        (one_joint(lower=-3.14, upper=3.14, kind=JointType.PRISMATIC), 0.0),
        (one_joint(lower=-3.14, upper=3.14, mimic=True), 0.0),
    ],
)
def test_packed_joint_is_full_turn_if_range_covers_circle(chain, full):
    row = pack_chain(chain)[-1]
    assert row[FULL_TURN] == full
    assert (row[LOWER], row[UPPER]) == (chain.lower_rad[0], chain.upper_rad[0])


def test_pack_links_has_one_row_per_link_with_its_joint():
    names, rows = pack_links(crane())
    at = {name: dict(zip(("row", "i"), (rows[i], i), strict=True)) for i, name in enumerate(names)}
    assert at["base"]["row"][PARENT] == -1
    assert at["hook"]["row"][PARENT] == at["cart"]["i"]
    hook, column, cart = (at[name]["row"] for name in ("hook", "column", "cart"))
    assert (hook[IS_PRISMATIC], column[IS_PRISMATIC]) == (1.0, 0.0)
    assert (hook[MIMIC_COLUMN], hook[MIMIC_SCALE], hook[MIMIC_OFFSET]) == (1.0, 0.5, 0.1)
    np.testing.assert_array_equal(hook[AXIS : AXIS + 3], [0.0, 0.0, -1.0])
    np.testing.assert_array_equal(cart[LINK_POSE : LINK_POSE + 3], [0.0, 0.0, 0.5])
    np.testing.assert_array_equal(cart[ORIGIN : ORIGIN + 9], np.eye(3).ravel())


def test_packed_fixed_joint_has_only_its_origin():
    names, rows = pack_links(planar(0.3, 0.2))
    row = rows[names.index("tip")]
    np.testing.assert_array_equal(row[LINK_POSE : LINK_POSE + 3], [0.2, 0.0, 0.0])
    assert not row[AXIS:PARENT].any()
    assert not row[IS_PRISMATIC:].any()


def test_pack_capsules_has_one_row_per_capsule_with_its_link():
    stick = Capsule("b", np.array([1.0, 2.0, 3.0]), np.array([4.0, 5.0, 6.0]), 0.7)
    (row,) = pack_capsules([stick], ["a", "b"])
    assert row[START : START + 3].tolist() == [1.0, 2.0, 3.0]
    assert row[END : END + 3].tolist() == [4.0, 5.0, 6.0]
    assert (row[RADIUS], row[LINK]) == (0.7, 1.0)
    assert pack_capsules([], ["a"]).shape == (0, 8)


def test_packed_joint_is_aligned_only_if_rotation_is_identity():
    for packed in (pack_chain(planar(0.3, 0.2)), pack_chain(crane())):
        for row in packed[1 : 2 + int(packed[0, STEPS])]:
            same = np.array_equal(placed(row)[:3, :3], np.eye(3))
            assert row[IS_ALIGNED] == float(same)
    tilted = pack_chain(one_joint(axis=(1e-9, 0.0, 1.0)))[1]
    np.testing.assert_array_equal(np.diag(placed(tilted)), 1.0)
    assert tilted[IS_ALIGNED] == 0.0
    assert pack_chain(one_joint())[1, IS_ALIGNED] == 1.0

"""Forward kinematics and Jacobians, compared with results by hand and with laws."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ikservo.errors import BadValueError, UnknownNameError
from ikservo.kinematics import Chain, JointType, joints
from ikservo.kinematics.se3 import make_pose
from tests.kinematics.chains import crane, joint, planar

angles = st.floats(-3.0, 3.0)


@given(angles, angles)
def test_planar_2r_forward_kinematics_equals_trigonometry(a, b):
    tip = planar(0.3, 0.2).forward([a, b])[:3, 3]
    expected = [0.3 * math.cos(a) + 0.2 * math.cos(a + b),
                0.3 * math.sin(a) + 0.2 * math.sin(a + b), 0.0]  # fmt: skip
    np.testing.assert_allclose(tip, expected, atol=1e-15)


def test_prismatic_joint_moves_its_mimic_joint():
    hook = crane().forward([math.pi / 2, 0.3])[:3, 3]
    np.testing.assert_allclose(hook, [0.0, 0.3, 0.5 - (0.5 * 0.3 + 0.1)], atol=1e-15)


def test_mimic_joint_is_not_a_degree_of_freedom():
    assert crane().names == ("turn", "slide")


def test_link_off_chain_to_tip_can_be_used_as_frame():
    lever = crane().forward([0.0, 0.0], frame="lever")
    assert math.atan2(lever[1, 0], lever[0, 0]) == pytest.approx(0.2)  # nearest to 0 in 0.2…0.9


def test_frame_offset_moves_point_without_rotation():
    chain = planar(0.3, 0.2)
    moved = chain.forward([0.0, math.pi / 2], frame="l2", offset_m=(0.2, 0, 0))
    np.testing.assert_allclose(moved, chain.forward([0.0, math.pi / 2]), atol=1e-15)


@given(angles, angles, angles, st.sampled_from(["l1", "l2", "l3", "tip"]), st.floats(-1, 1))
def test_jacobian_of_any_point_is_central_difference(a, b, c, frame, x):
    _assert_jacobian(planar(0.3, 0.2, 0.1), np.array([a, b, c]), frame, (x, 0.1, -0.2))


@given(angles, st.floats(0.0, 0.4))
def test_jacobian_of_prismatic_and_mimic_is_central_difference(turn, slide):
    _assert_jacobian(crane(), np.array([turn, slide]), "hook", (0.02, 0.0, 0.01))


def test_jacobian_is_zero_for_joints_beyond_frame():
    J = planar(0.3, 0.2, 0.1).jacobian([0.1, 0.2, 0.3], frame="l1")
    assert not J[:, 1:].any()


def test_chain_with_new_limits_leaves_original_unchanged():
    chain = planar(0.3, 0.2)
    narrow = chain.with_limits([-1, 0], [1, 2])
    assert narrow.lower_rad.tolist() == [-1, 0]
    assert chain.lower_rad.tolist() == [-math.pi, -math.pi]


def test_chain_limits_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        planar(0.3, 0.2).lower_rad[0] = 5.0


def test_reversed_joint_limits_are_refused_with_joint_name():
    with pytest.raises(BadValueError, match="range of j2"):
        planar(0.3, 0.2).with_limits([-1, 2], [1, 0])


@pytest.mark.parametrize("q", [[0.0], [0.0, math.nan], [math.inf, 0.0], "ab", [[[0.0, 0.0]]], None])
def test_joint_vector_of_wrong_size_or_nan_is_refused(q):
    with pytest.raises(BadValueError):
        planar(0.3, 0.2).forward(q)


def test_unknown_frame_error_suggests_closest_link():
    with pytest.raises(UnknownNameError, match="Did you mean tip"):
        planar(0.3, 0.2).forward([0, 0], frame="tipp")


def test_chain_does_not_depend_on_joint_order_of_description():
    assert crane().frames == tuple(crane().link_poses([0, 0]))
    assert set(crane().frames) == {"base", "column", "cart", "hook", "lever"}


def test_chain_tip_without_moving_joint_is_refused():
    fixed = joint("weld", JointType.FIXED, "base", "tip")
    with pytest.raises(ValueError, match="No joint moves 'tip'"):
        Chain.from_joints([fixed], "base", "tip")


def _assert_jacobian(chain, q, frame, offset_m, h=1e-6):
    J = chain.jacobian(q, frame, offset_m)
    for i in range(chain.dof):
        step = np.zeros(chain.dof)
        step[i] = h
        after = chain.forward(q + step, frame, offset_m)
        before = chain.forward(q - step, frame, offset_m)
        np.testing.assert_allclose(J[:3, i], (after - before)[:3, 3] / (2 * h), atol=1e-7)
        spin = (after - before)[:3, :3] / (2 * h) @ chain.forward(q, frame)[:3, :3].T
        np.testing.assert_allclose(J[3:, i], [spin[2, 1], spin[0, 2], spin[1, 0]], atol=1e-7)


def test_chain_tip_not_connected_to_base_is_refused():
    arm = joint("elbow", JointType.REVOLUTE, "base", "hand")
    with pytest.raises(UnknownNameError, match="hnad"):
        Chain.from_joints([arm], "base", "hnad")


def test_joint_limits_may_be_single_value():
    locked = planar(0.3, 0.2).with_limits([0.5, -1.0], [0.5, 1.0])
    assert locked.upper_rad.tolist() == [0.5, 1.0]


def test_chain_mid_range_is_middle_of_joint_limits():
    chain = planar(0.3, 0.2).with_limits([-1.0, 0.5], [2.0, 1.0])
    assert chain.mid_range().tolist() == [0.5, 0.75]


def test_mid_range_of_one_sided_limit_is_value_nearest_zero():
    turning = joint("spin", JointType.REVOLUTE, "base", "tip", lower=0.5)
    assert Chain.from_joints([turning], "base", "tip").mid_range().tolist() == [0.5]


def test_one_sided_limit_may_be_narrowed_on_that_side_only():
    turning = joint("spin", JointType.REVOLUTE, "base", "tip", lower=0.5)
    chain = Chain.from_joints([turning], "base", "tip")
    narrow = chain.with_limits([0.7], [math.inf])
    assert (narrow.lower_rad[0], narrow.upper_rad[0]) == (0.7, math.inf)
    with pytest.raises(BadValueError, match="upper limits"):
        chain.with_limits([0.7], [-math.inf])


@pytest.mark.parametrize("limits", [[0.0], [0.0, 0.0, 0.0], 0.0, [[0.0, 0.0]]])
def test_limits_for_wrong_number_of_joints_are_refused(limits):
    with pytest.raises(BadValueError, match="lower limits"):
        planar(0.3, 0.2).with_limits(limits, [1.0, 1.0])


def test_chain_with_new_origin_leaves_original_unchanged():
    chain, q = planar(0.3, 0.2), [0.0, math.pi / 2]
    moved = chain.with_origins({"j2": make_pose(np.array([0.4, 0.0, 0.1]))})
    np.testing.assert_allclose(moved.forward(q)[:3, 3], [0.4, 0.2, 0.1], atol=1e-15)
    np.testing.assert_allclose(chain.forward(q)[:3, 3], [0.3, 0.2, 0.0], atol=1e-15)


def test_chain_origin_of_unknown_joint_or_bad_pose_is_refused():
    chain = planar(0.3, 0.2)
    with pytest.raises(UnknownNameError, match="Did you mean j2"):
        chain.with_origins({"jj2": np.eye(4)})
    for T in (np.eye(3), np.full((4, 4), math.nan)):
        with pytest.raises(BadValueError, match="The origin of j2"):
            chain.with_origins({"j2": T})
    with pytest.raises(BadValueError, match="The mapping of origins"):
        chain.with_origins([np.eye(4)])


def test_repr_of_chain_omits_internal_tables():
    assert "names=('turn', 'slide')" in repr(crane())
    assert "ChainJoint" not in repr(crane())


def test_mimic_joints_of_long_chain_are_resolved_once(monkeypatch):
    resolved, resolve = [], joints._resolve_mimic
    monkeypatch.setattr(
        joints, "_resolve_mimic", lambda *words: resolved.append(1) or resolve(*words)
    )
    counts = []
    for count in (50, 100):
        row = [
            joint(f"j{i}", JointType.REVOLUTE, f"l{i}", f"l{i + 1}", lower=-1.0, upper=1.0)
            for i in range(count)
        ]
        resolved.clear()
        Chain.from_joints(row, "l0", f"l{count}")
        counts.append(len(resolved))
    assert counts[1] <= 2.1 * counts[0]

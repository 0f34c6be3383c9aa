"""Laws of SO(3), also near zero and near a half turn."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ikservo.kinematics import se3

lengths = st.one_of(
    st.floats(1e-9, math.pi - 1e-9),
    st.floats(0.0, 1e-6),
    st.floats(math.pi - 1e-5, math.pi - 1e-9),
)


@st.composite
def rotation_vectors(draw):
    axis = np.array([draw(st.floats(-1, 1)) for _ in range(3)])
    norm = np.linalg.norm(axis)
    axis = axis / norm if norm > 1e-3 else np.array([0.0, 0.0, 1.0])
    return draw(lengths) * axis


@given(rotation_vectors())
def test_exp_so3_is_orthogonal_with_determinant_one(w):
    R = se3.exp_so3(w)
    np.testing.assert_allclose(R @ R.T, np.eye(3), atol=1e-14)
    assert np.linalg.det(R) == pytest.approx(1.0)


@given(rotation_vectors())
def test_exp_so3_inverts_log_so3(w):
    R = se3.exp_so3(w)
    np.testing.assert_allclose(se3.exp_so3(se3.log_so3(R)), R, atol=1e-9)


@given(rotation_vectors())
def test_log_so3_inverts_exp_so3_below_half_turn(w):
    np.testing.assert_allclose(se3.log_so3(se3.exp_so3(w)), w, atol=1e-7)


@pytest.mark.parametrize("axis", [(1, 0, 0), (0, 1, 0), (0, 0, 1), (0.6, 0, -0.8)])
def test_log_so3_of_half_turn_has_length_pi(axis):
    R = se3.exp_so3(math.pi * np.array(axis))
    assert np.linalg.norm(se3.log_so3(R)) == pytest.approx(math.pi)
    np.testing.assert_allclose(se3.exp_so3(se3.log_so3(R)), R, atol=1e-12)


def test_rotation_rpy_turns_about_fixed_axes_x_then_y_then_z():
    x, y, z = np.eye(3)
    expected = se3.exp_so3(0.3 * z) @ se3.exp_so3(-0.7 * y) @ se3.exp_so3(1.1 * x)
    np.testing.assert_allclose(se3.rotation_rpy(1.1, -0.7, 0.3), expected, atol=1e-15)


@given(rotation_vectors(), rotation_vectors())
def test_skew_matrix_product_equals_cross_product(a, b):
    np.testing.assert_allclose(se3.skew(a) @ b, np.cross(a, b), atol=1e-12)


@pytest.mark.parametrize("angle_rad", [9e-5, 1e-6, 2e-4])
def test_log_so3_of_small_rotation_keeps_full_precision(angle_rad):
    w = angle_rad * np.array([0.6, 0.0, 0.8])
    np.testing.assert_allclose(se3.log_so3(se3.exp_so3(w)), w, rtol=1e-10)


@pytest.mark.parametrize("short_of_half_a_turn_rad", [0.0, 1e-9, 1e-5])
def test_log_so3_near_half_turn_keeps_its_axis(short_of_half_a_turn_rad):
    w = (np.pi - short_of_half_a_turn_rad) * np.array([0.48, -0.6, 0.64])
    found = se3.log_so3(se3.exp_so3(w))
    np.testing.assert_allclose(np.abs(found), np.abs(w), rtol=1e-7)
    np.testing.assert_allclose(se3.exp_so3(found), se3.exp_so3(w), atol=1e-9)

"""An invalid target is refused before any iteration."""

import math

import numpy as np
import pytest

from ikservo.errors import BadValueError, InputError, UnknownNameError
from ikservo.ik import Target, solve
from tests.kinematics.chains import planar


@pytest.mark.parametrize(
    "position", [(0, 0), (0, 0, math.nan), (0, math.inf, 0), "abc", None, [[0, 0, 0]]]
)
def test_target_position_must_be_three_finite_numbers(position):
    with pytest.raises(BadValueError, match="target position"):
        Target(position)


def test_target_direction_of_zero_length_is_refused():
    with pytest.raises(BadValueError, match="wanted direction is zero"):
        Target((0, 0, 0), direction=(0, 0, 0))


@pytest.mark.parametrize("matrix", [np.zeros((3, 3)), np.diag([1, 1, -1]), 2 * np.eye(3)])
def test_target_orientation_must_be_a_rotation(matrix):
    with pytest.raises(BadValueError, match="not a rotation matrix"):
        Target((0, 0, 0), orientation=matrix)


@pytest.mark.parametrize("matrix", [np.zeros(4), np.full((3, 3), math.nan), "x"])
def test_target_orientation_must_be_nine_finite_numbers(matrix):
    with pytest.raises(BadValueError, match="orientation"):
        Target((0, 0, 0), orientation=matrix)


def test_target_refuses_direction_together_with_orientation():
    with pytest.raises(InputError, match="a direction and an orientation"):
        Target((0, 0, 0), direction=(1, 0, 0), orientation=np.eye(3))


def test_ik_orientation_error_is_angle_between_axes():
    target = Target((0, 0, 0), direction=(1, 0, 0), tool_axis=(0, 0, 2))
    np.testing.assert_allclose(target.orientation_error(np.eye(3)), [0, math.pi / 2, 0], atol=1e-15)


def test_ik_orientation_error_of_opposite_axes_is_half_turn():
    target = Target((0, 0, 0), direction=(0, 0, -1))
    assert np.linalg.norm(target.orientation_error(np.eye(3))) == pytest.approx(math.pi)


def test_unknown_frame_is_refused():
    with pytest.raises(UnknownNameError, match="link"):
        solve(planar(0.3, 0.2), Target((0.1, 0, 0), frame="nose"))

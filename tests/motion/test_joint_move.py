"""A motion keeps its pace at every instant and all joints arrive together."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from ikservo.errors import BadValueError
from ikservo.motion import JointMove, Pace

PACES = [Pace(1.0, 2.0, 20.0), Pace(0.5, 3.0, 15.0)]
joints = st.tuples(st.floats(-3, 3), st.floats(-3, 3)).map(np.array)


@settings(max_examples=50, deadline=None)
@given(joints, joints)
def test_no_joint_is_ever_faster_than_its_pace(start, goal):
    move = JointMove(start, goal, PACES)
    steps = _sampled(move)
    speeds = np.abs(np.diff(steps, axis=0)).max(axis=0) / _spacing(move)
    assert (speeds <= np.array([1.0, 0.5]) * (1 + 1e-6) + 1e-9).all()


@settings(max_examples=50, deadline=None)
@given(joints, joints)
def test_the_way_never_leaves_the_box_between_start_and_goal(start, goal):
    steps = _sampled(JointMove(start, goal, PACES))
    assert (steps >= np.minimum(start, goal) - 1e-9).all()
    assert (steps <= np.maximum(start, goal) + 1e-9).all()


@settings(max_examples=50, deadline=None)
@given(joints, joints)
def test_it_starts_at_the_start_and_ends_at_the_goal_exactly(start, goal):
    move = JointMove(start, goal, PACES)
    np.testing.assert_array_equal(move.at(-1.0), start)
    np.testing.assert_array_equal(move.at(1e9), goal)
    np.testing.assert_allclose(move.at(1e-9), start, atol=1e-9)
    np.testing.assert_allclose(move.at(move.duration_s - 1e-9), goal, atol=1e-6)


def test_the_slowest_joint_sets_the_time_for_all():
    alone = JointMove([0, 0], [0, 1], PACES).duration_s
    assert JointMove([0, 0], [0.1, 1], PACES).duration_s == pytest.approx(alone)


def test_no_way_takes_no_time():
    assert JointMove([1, 2], [1, 2], PACES).duration_s == 0.0


@pytest.mark.parametrize("goal", [[1], [1, math.nan], [math.inf, 0]])
def test_a_goal_that_is_no_joint_vector_is_refused(goal):
    with pytest.raises(BadValueError, match="goal of the motion"):
        JointMove([0, 0], goal, PACES)


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan, math.inf])
def test_a_pace_is_positive(speed):
    with pytest.raises(BadValueError, match="speed_rad_s"):
        Pace(speed, 1.0, 1.0)


def _sampled(move):
    return np.array([move.at(t) for t in np.linspace(0, move.duration_s, 200)])


def _spacing(move):
    return max(move.duration_s / 199, 1e-12)

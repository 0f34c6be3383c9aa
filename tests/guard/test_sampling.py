"""Paths are sampled densely enough for collision checks, both ends included."""

import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st

from ikservo.guard import MAX_SAMPLE_STEP_RAD, sample_line, sample_path, thin_path
from ikservo.motion import JointMove, KinematicLimits

PACES = [KinematicLimits(1.0, 2.0, 20.0), KinematicLimits(0.5, 3.0, 15.0)]
joints = st.tuples(st.floats(-3, 3), st.floats(-3, 3)).map(np.array)


def sampled(start, goal, paces):
    move = JointMove(start, goal, paces)
    return sample_path(move.at, move.duration_s, move.top_speed)


def largest_step(path):
    return np.abs(np.diff(path, axis=0)).max()


@settings(max_examples=50, deadline=None)
@given(joints, joints)
def test_sampled_motion_steps_stay_within_sampling_step(start, goal):
    path = sampled(start, goal, PACES)
    assert largest_step(path) <= MAX_SAMPLE_STEP_RAD + 1e-9
    np.testing.assert_allclose(path[0], start, atol=1e-12)
    np.testing.assert_allclose(path[-1], goal, atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(joints, joints)
def test_joints_of_equal_speed_move_straight_to_goal(start, goal):
    path = sampled(start, goal, [PACES[0]] * 2)
    span = goal - start
    across = (path - start) @ np.array([span[1], -span[0]])
    np.testing.assert_allclose(across, 0, atol=1e-6)


def test_sample_count_of_fast_motion_depends_on_distance():
    path = sample_path(lambda time_s: np.array([3.0 * time_s]), 2.0, 3.0)
    assert len(path) == 1 + round(6.0 / MAX_SAMPLE_STEP_RAD)


@given(joints, joints)
def test_joint_space_line_is_sampled_evenly_with_exact_ends(start, goal):
    path = sample_line(start, goal)
    assert largest_step(path) <= MAX_SAMPLE_STEP_RAD + 1e-9
    np.testing.assert_array_equal(path[[0, -1]], [start, goal])


def test_sliding_joint_is_sampled_by_angle_of_servo_horn():
    start, goal = np.zeros(2), np.array([0.1, 0.10])  # rad and m
    path = sample_line(start, goal, np.array([1.0, 0.01]))  # 10 rad of the slide's horn
    assert len(path) == 1 + round(10.0 / MAX_SAMPLE_STEP_RAD)


def test_rotation_path_is_sampled_by_largest_joint_angle():
    assert len(sample_line(np.zeros(2), np.array([0.2, -1.0]))) == 1 + 20


def test_joint_space_line_of_zero_length_has_two_samples():
    assert sample_line(np.ones(3), np.ones(3)).shape == (2, 3)


@given(st.lists(st.floats(-0.02, 0.02), min_size=1, max_size=200))
def test_thinned_path_steps_stay_within_sampling_step(steps):
    dense = np.cumsum([0.0, *steps])[:, None]
    path = thin_path(dense)
    assert largest_step(path) <= MAX_SAMPLE_STEP_RAD + 0.02 + 1e-9 if len(path) > 1 else True
    assert path[-1] == dense[-1]
    assert path[0] == dense[0] or np.ptp(dense) == 0.0


def test_thinned_path_counts_distance_there_and_back():
    there_and_back = np.concatenate([np.linspace(0, 1, 1001), np.linspace(1, 0, 1001)])[:, None]
    path = thin_path(there_and_back)
    assert path.max() > 1.0 - MAX_SAMPLE_STEP_RAD
    assert 40 <= len(path) <= 43


def test_thinned_path_keeps_row_per_step_with_resting_joint():
    dense = np.column_stack([np.linspace(0.0, 1.0, 1001), np.zeros(1001)])
    np.testing.assert_allclose(thin_path(dense)[:, 0], np.linspace(0.0, 1.0, 21), atol=0.0011)


def test_thinning_keeps_all_rows_of_coarse_path():
    coarse = np.array([[0.0], [0.2], [0.4], [0.3], [0.6]])
    np.testing.assert_array_equal(thin_path(coarse), coarse)

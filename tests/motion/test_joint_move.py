"""A motion keeps its speed limits at every instant, and all joints arrive together."""

import math

import numpy as np
import pytest
import ruckig
from hypothesis import example, given, settings
from hypothesis import strategies as st

from ikservo.errors import BadValueError, RefusedError
from ikservo.motion import JointMove, KinematicLimits, TrajectoryPoint, stop_trajectory
from tests.motion.laws import assert_keeps_paces

PACES = [KinematicLimits(1.0, 2.0, 20.0), KinematicLimits(0.5, 3.0, 15.0)]
joints = st.tuples(st.floats(-3, 3), st.floats(-3, 3)).map(np.array)


@settings(max_examples=50, deadline=None)
@given(joints, joints)
def test_joint_move_never_exceeds_speed_limit(start, goal):
    move = JointMove(start, goal, PACES)
    steps = _sampled(move)
    speeds = np.abs(np.diff(steps, axis=0)).max(axis=0) / _spacing(move)
    assert (speeds <= np.array([1.0, 0.5]) * (1 + 1e-6) + 1e-9).all()


@settings(max_examples=50, deadline=None)
@given(joints, joints)
def test_joint_move_stays_between_start_and_goal(start, goal):
    steps = _sampled(JointMove(start, goal, PACES))
    assert (steps >= np.minimum(start, goal) - 1e-9).all()
    assert (steps <= np.maximum(start, goal) + 1e-9).all()


@settings(max_examples=50, deadline=None)
@given(joints, joints)
def test_joint_move_starts_and_ends_exactly_at_given_positions(start, goal):
    move = JointMove(start, goal, PACES)
    np.testing.assert_array_equal(move.at(-1.0), start)
    np.testing.assert_array_equal(move.at(1e9), goal)
    np.testing.assert_allclose(move.at(1e-9), start, atol=1e-9)
    np.testing.assert_allclose(move.at(move.duration_s - 1e-9), goal, atol=1e-6)


def test_slowest_joint_sets_duration_of_joint_move():
    alone = JointMove([0, 0], [0, 1], PACES).duration_s
    assert JointMove([0, 0], [0.1, 1], PACES).duration_s == pytest.approx(alone)


def test_joint_move_to_its_start_takes_no_time():
    assert JointMove([1, 2], [1, 2], PACES).duration_s == 0.0


@pytest.mark.parametrize("goal", [[1], [1, math.nan], [math.inf, 0]])
def test_invalid_goal_of_joint_move_is_refused(goal):
    with pytest.raises(BadValueError, match="goal of the motion"):
        JointMove([0, 0], goal, PACES)


@pytest.mark.parametrize("speed", [0.0, -1.0, math.nan, math.inf])
def test_joint_speed_limit_must_be_positive_and_finite(speed):
    with pytest.raises(BadValueError, match="speed_rad_s"):
        KinematicLimits(speed, 1.0, 1.0)


def _sampled(move):
    return np.array([move.at(t) for t in np.linspace(0, move.duration_s, 200)])


def _spacing(move):
    return max(move.duration_s / 199, 1e-12)


@settings(max_examples=60, deadline=None)
@given(joints, joints, joints, st.floats(0.0, 1.0))
@example(np.array([-1.0, 0.5]), np.array([-0.5, 0.0]), np.array([-0.5, 0.0]), 0.998046875)
def test_retargeted_joint_move_has_no_jump(start, first, second, share):
    move = JointMove(start, first, PACES)
    before = move.state(share * move.duration_s)
    after = JointMove(before, second, PACES)
    np.testing.assert_array_equal(after.state(0.0).position, before.position)
    np.testing.assert_allclose(after.state(1e-7).velocity, before.velocity, atol=1e-5)
    np.testing.assert_allclose(after.at(after.duration_s), second, atol=1e-12)


@pytest.mark.parametrize("remaining", [1e-4, 1e-6, 1e-8, 1e-10, 1e-12, 1e-14])
def test_arriving_joint_move_is_retargeted_to_its_goal(remaining):
    rng = np.random.default_rng(int(-np.log10(remaining)))
    for _ in range(100):
        start, goal = rng.uniform(-2, 2, (2, 2))
        move = JointMove(start, goal, PACES)
        after = JointMove(move.state((1.0 - remaining) * move.duration_s), goal, PACES)
        np.testing.assert_allclose(after.at(after.duration_s), goal, atol=1e-12)


@settings(max_examples=60, deadline=None)
@given(joints, joints, st.floats(0.0, 1.0))
def test_retargeted_joint_move_keeps_kinematic_limits(start, goal, share):
    move = JointMove(start, goal, PACES)
    turned = JointMove(move.state(share * move.duration_s), start, PACES)
    states = [turned.state(t) for t in np.linspace(0, turned.duration_s, 100)]
    for i, pace in enumerate(PACES):
        assert max(abs(s.velocity[i]) for s in states) <= pace.speed_rad_s * (1 + 1e-6)
        assert max(abs(s.acceleration[i]) for s in states) <= pace.acceleration_rad_s2 * (1 + 1e-6)


@settings(max_examples=60, deadline=None)
@given(joints, joints, st.floats(0.0, 1.0))
def test_stop_trajectory_ends_at_rest_in_shortest_time(start, goal, share):
    move = JointMove(start, goal, PACES)
    moving = move.state(share * move.duration_s)
    stop = stop_trajectory(moving, PACES)
    np.testing.assert_allclose(stop.state(stop.duration_s - 1e-9).velocity, 0, atol=1e-6)
    # v/a + a/j is the longest that a stop from full speed can take, and the build-up of a again.
    assert stop.duration_s <= max(p.speed_rad_s / p.acceleration_rad_s2 for p in PACES) + 3 * 0.2


def test_stop_trajectory_of_resting_joints_takes_no_time():
    assert stop_trajectory(TrajectoryPoint.at_rest([1.0, 2.0]), PACES).duration_s == 0.0


SLOW_AND_FAST = [
    KinematicLimits(1.0, 2.0, 20.0),
    KinematicLimits(0.5, 3.0, 15.0),
    KinematicLimits(2.0, 9.0, 60.0),
]
three = st.tuples(*[st.floats(-3, 3)] * 3).map(np.array)


@settings(max_examples=60, deadline=None)
@given(three, three)
def test_joint_move_keeps_speed_acceleration_and_jerk_limits(start, goal):
    assert_keeps_paces(JointMove(start, goal, SLOW_AND_FAST), SLOW_AND_FAST)


@settings(max_examples=60, deadline=None)
@given(three, three)
def test_joint_move_brings_all_joints_to_goal_at_same_time(start, goal):
    move = JointMove(start, goal, SLOW_AND_FAST)
    before = move.at(move.duration_s - min(0.02, 0.1 * move.duration_s))
    far = np.abs(goal - start) > 1e-3
    assert (np.abs(before - goal)[far] > 0).all()


@settings(max_examples=40, deadline=None)
@given(three, three, st.floats(0.0, 1.0))
def test_stop_trajectory_keeps_acceleration_and_jerk_limits(start, goal, share):
    move = JointMove(start, goal, SLOW_AND_FAST)
    assert_keeps_paces(
        stop_trajectory(move.state(share * move.duration_s), SLOW_AND_FAST), SLOW_AND_FAST
    )


def test_joint_move_extent_includes_overshoot_of_moving_start():
    moving = TrajectoryPoint(np.zeros(1), np.ones(1), np.zeros(1))
    lowest, highest = JointMove(moving, [-0.5], [PACES[0]]).extent
    assert lowest == pytest.approx([-0.5])
    assert 0.2 < highest[0] < 0.5


@pytest.mark.parametrize("what", ["velocity", "acceleration"])
def test_joint_move_start_state_with_nan_is_refused(what):
    broken = {"velocity": np.zeros(2), "acceleration": np.zeros(2)} | {
        what: np.array([0, math.nan])
    }
    with pytest.raises(BadValueError, match=f"{what} at the start"):
        JointMove(TrajectoryPoint(np.zeros(2), **broken), [1, 1], PACES)


def test_joint_move_that_ruckig_cannot_solve_is_refused():
    with pytest.raises(RefusedError, match="No motion to the goal was found"):
        JointMove([-1e12], [1e12], [KinematicLimits(1.0, 1.0, 1.0)])


def test_ruckig_error_result_raises_error(monkeypatch):
    failed = ruckig.Result.ErrorSynchronizationCalculation
    monkeypatch.setattr("ikservo.motion.point_to_point.Ruckig", lambda _: Failing(failed))
    with pytest.raises(RefusedError, match="ErrorSynchronizationCalculation"):
        JointMove([0.0], [1.0], [PACES[0]])


class Failing:
    """A solver that fails like ruckig."""

    def __init__(self, result):
        self.result = result

    def calculate(self, wanted, trajectory):
        return self.result


def test_stop_trajectory_has_same_attributes_as_joint_move():
    moving = TrajectoryPoint(np.zeros(2), np.array([0.8, -0.2]), np.zeros(2))
    stop = stop_trajectory(moving, PACES)
    assert vars(stop).keys() == vars(JointMove([0.0, 0.0], [1.0, 1.0], PACES)).keys()
    assert stop.top_speed == 1.0
    np.testing.assert_array_equal(stop.state(stop.duration_s).velocity, np.zeros(2))
    np.testing.assert_array_equal(stop.at(0.0), moving.position)

"""A goal that changes in mid-motion: no stop, no jump, no limit passed."""

import math

import numpy as np
import pytest

from ikservo.errors import BadValueError, RefusedError
from ikservo.motion import JointMove, KinematicLimits, OnlineTrajectory, TrajectoryPoint
from tests.motion.laws import assert_inside, assert_keeps_paces, assert_smooth

PACES = [
    KinematicLimits(1.0, 3.0, 30.0),
    KinematicLimits(0.4, 5.0, 40.0),
    KinematicLimits(2.0, 6.0, 90.0),
]
SEEDS = range(6)


def chased(seed, aims=10, ended=True):
    """Return a pursuit of goals at random instants, mostly at or past its limits, and the goals."""
    rng = np.random.default_rng(seed)
    lower, upper = -rng.uniform(0.02, 1.0, 3), rng.uniform(0.02, 1.0, 3)
    course, time_s = Recorded(np.zeros(3), PACES, lower=lower, upper=upper), 0.0
    for _ in range(aims):
        course.retarget(rng.choice([lower, upper, rng.uniform(2 * lower, 2 * upper)]), time_s)
        time_s += float(rng.choice([0.0, 0.01, rng.uniform(0.0, 1.0)]))
    if ended:
        course.stop(time_s)
    return course, lower, upper


class Recorded(OnlineTrajectory):
    """Records its whole past, so that a test can sample it as one motion."""

    def __init__(self, *args, **kwargs):
        super().__init__(*args, **kwargs)
        self._past = [(0.0, self._pieces)]

    def retarget(self, goal, time_s):
        answer = super().retarget(goal, time_s)
        self._past.append((time_s, self._pieces))
        return answer

    def stop(self, time_s):
        super().stop(time_s)
        self._past.append((time_s, self._pieces))

    def state(self, time_s):
        if hasattr(self, "_past"):
            known = [pieces for since_s, pieces in self._past if since_s <= max(time_s, 0.0)]
            newest, self._pieces = self._pieces, known[-1]
            try:
                return super().state(time_s)
            finally:
                self._pieces = newest
        return super().state(time_s)


@pytest.mark.parametrize("seed", SEEDS)
def test_online_trajectory_keeps_kinematic_limits(seed):
    course, _, _ = chased(seed)
    assert_keeps_paces(course, PACES, count=1500)


@pytest.mark.parametrize("seed", SEEDS)
def test_online_trajectory_never_leaves_position_limits(seed):
    course, lower, upper = chased(seed)
    assert_inside(course, lower, upper)


@pytest.mark.parametrize("seed", SEEDS)
def test_online_trajectory_has_no_jump_at_new_goal(seed):
    course, _, _ = chased(seed)
    assert_smooth(course, count=1500)


@pytest.mark.parametrize("seed", SEEDS)
def test_online_trajectory_comes_to_rest_at_last_goal(seed):
    course, _, _ = chased(seed, ended=False)
    rest = course.state(course.settles_at_s)
    np.testing.assert_allclose(rest.position, course.goal, atol=1e-9)
    np.testing.assert_allclose(rest.velocity, 0, atol=1e-12)
    assert course.duration_s == math.inf


@pytest.mark.parametrize("seed", SEEDS)
def test_stopped_online_trajectory_stays_at_rest(seed):
    course, _, _ = chased(seed)
    assert math.isfinite(course.duration_s)
    for time_s in (course.duration_s, course.duration_s + 1.0, 1e9):
        np.testing.assert_allclose(course.state(time_s).velocity, 0, atol=1e-12)
        np.testing.assert_allclose(course.state(time_s).position, course.goal, atol=1e-12)


def test_online_trajectory_without_goal_stays_at_rest():
    course = OnlineTrajectory([0.1, 0.2, 0.3], PACES)
    np.testing.assert_array_equal(course.state(5.0).position, [0.1, 0.2, 0.3])


def test_online_trajectory_is_as_fast_as_joint_move():
    course = OnlineTrajectory(np.zeros(3), PACES)
    course.retarget([1.0, 0.5, -0.7], 2.0)
    assert course.settles_at_s == pytest.approx(
        2.0 + JointMove(np.zeros(3), course.goal, PACES).duration_s
    )


def test_repeated_equal_online_goal_changes_nothing():
    once, often = OnlineTrajectory(np.zeros(3), PACES), OnlineTrajectory(np.zeros(3), PACES)
    once.retarget([1.0, 0.5, -0.7], 0.0)
    for time_s in np.arange(0.0, 1.0, 0.01):
        often.retarget([1.0, 0.5, -0.7], float(time_s))
    np.testing.assert_array_equal(often.state(1.1).position, once.state(1.1).position)


def test_online_trajectory_joints_arrive_together_at_new_goal():
    course = OnlineTrajectory(np.zeros(3), PACES)
    course.retarget([1.0, 0.5, -0.7], 0.0)
    course.retarget([-0.3, 0.4, 0.1], 0.4)
    before = course.state(course.settles_at_s - 0.02)
    assert (np.abs(before.position - course.goal) > 1e-8).all()


def test_online_goal_beyond_limit_is_clipped_to_limit():
    course = OnlineTrajectory(np.zeros(3), PACES, lower=[-1, -1, -1], upper=[1, 1, 1])
    np.testing.assert_array_equal(course.retarget([5, 0, -5], 0.0), [1, 0, -1])
    np.testing.assert_array_equal(course.goal, [1, 0, -1])


def test_online_start_outside_limits_is_kept_until_new_goal():
    course = OnlineTrajectory([1.1, 0, 0], PACES, lower=[-1, -1, -1], upper=[1, 1, 1])
    np.testing.assert_array_equal(course.state(3.0).position, [1.1, 0, 0])
    np.testing.assert_array_equal(course.retarget([1.05, 0, 0], 3.0), [1, 0, 0])


def test_online_trajectory_continues_motion_without_jump():
    move = JointMove(np.zeros(3), [1.0, 0.5, -0.7], PACES)
    course = OnlineTrajectory(move.state(0.5), PACES)
    np.testing.assert_allclose(course.state(0.0).velocity, move.state(0.5).velocity)
    np.testing.assert_allclose(course.state(course.settles_at_s).velocity, 0, atol=1e-12)


def test_online_motion_that_cannot_stop_in_limits_is_refused():
    fast = TrajectoryPoint(np.zeros(3), np.array([1.0, 0, 0]), np.zeros(3))
    with pytest.raises(RefusedError, match="too fast"):
        OnlineTrajectory(fast, PACES, lower=[-1, -1, -1], upper=[0.01, 1, 1])


@pytest.mark.parametrize("goal", [[1, 2], [1, 2, math.nan], [math.inf, 0, 0], "here"])
def test_invalid_online_goal_is_refused_and_old_one_kept(goal):
    course = OnlineTrajectory(np.zeros(3), PACES)
    course.retarget([1, 0, 0], 0.0)
    with pytest.raises(BadValueError, match="The goal"):
        course.retarget(goal, 0.1)
    np.testing.assert_array_equal(course.goal, [1, 0, 0])


@pytest.mark.parametrize("time_s", [0.4, -1.0, math.nan, math.inf])
@pytest.mark.parametrize("what", ["aim", "end"])
def test_online_retarget_and_stop_refuse_earlier_time(time_s, what):
    course = OnlineTrajectory(np.zeros(3), PACES)
    course.retarget([1, 0, 0], 0.5)
    with pytest.raises(BadValueError, match="time of the goal"):
        course.retarget([0, 0, 0], time_s) if what == "aim" else course.stop(time_s)


def test_new_online_goal_takes_effect_before_old_is_reached():
    course = OnlineTrajectory(np.zeros(3), PACES)
    course.retarget([1.0, 0, 0], 0.0)
    old_end_s = course.settles_at_s
    course.retarget([0.3, 0, 0], 0.5 * old_end_s)
    assert course.state(old_end_s).position[0] < 0.9


def test_online_stop_during_motion_ends_before_goal():
    course = OnlineTrajectory(np.zeros(3), PACES)
    course.retarget([1.0, 0, 0], 0.0)
    goal_s = course.settles_at_s
    course.stop(0.4 * goal_s)
    assert course.duration_s < goal_s
    assert course.goal[0] < 0.9


def test_online_stop_that_would_pass_limit_ends_at_old_goal():
    course = OnlineTrajectory(np.zeros(3), PACES, lower=[-1, -1, -1], upper=[1, 1, 1])
    course.retarget([1.0, 0, 0], 0.0)
    goal_s = course.settles_at_s
    course.set_limits(
        [KinematicLimits(1.0, 0.3, 3.0), *PACES[1:]]
    )  # these could not stop it before the limit
    course.stop(0.7 * goal_s)
    assert course.duration_s == goal_s
    assert_inside(course, [-1, -1, -1], [1, 1, 1])


def test_stopped_online_trajectory_refuses_new_goal():
    course = OnlineTrajectory(np.zeros(3), PACES)
    course.stop(1.0)
    course.stop(2.0)
    assert course.duration_s == 1.0
    with pytest.raises(RefusedError, match="ended"):
        course.retarget([1, 0, 0], 3.0)


@pytest.mark.parametrize("limits", [{"lower": [1, 1, 1], "upper": [0, 2, 2]}, {"lower": [0, 0]},
                                    {"upper": [math.nan, 1, 1]}])  # fmt: skip
def test_invalid_online_position_limits_are_refused(limits):
    with pytest.raises(BadValueError, match="limits"):
        OnlineTrajectory(np.zeros(3), PACES, **limits)


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(100, 600))
def test_online_trajectory_keeps_every_limit_in_campaign(seed):
    course, lower, upper = chased(seed, aims=20)
    assert_keeps_paces(course, PACES, count=3000)
    assert_inside(course, lower, upper, count=3000)
    assert_smooth(course, count=3000)


def test_online_goal_refused_by_check_keeps_old_goal():
    course = OnlineTrajectory(np.zeros(3), PACES)
    course.retarget([0.5, 0.0, 0.0], 0.0)

    def object_to(move):
        raise RefusedError(f"it goes to {move.goal[1]}", "")

    with pytest.raises(RefusedError, match=r"it goes to 0\.3"):
        course.retarget([0.0, 0.3, 0.0], 0.4, object_to)
    np.testing.assert_allclose(course.goal, [0.5, 0.0, 0.0])

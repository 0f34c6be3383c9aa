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
    """Return a pursuit of goals at random instants, mostly at or past its limits, and these."""
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
    """Remembers the whole of its past, so that a test can sample it as one motion."""

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
def test_a_goal_that_changes_at_random_keeps_every_pace(seed):
    course, _, _ = chased(seed)
    assert_keeps_paces(course, PACES, count=1500)


@pytest.mark.parametrize("seed", SEEDS)
def test_positions_never_leave_the_limits_whatever_is_asked(seed):
    course, lower, upper = chased(seed)
    assert_inside(course, lower, upper)


@pytest.mark.parametrize("seed", SEEDS)
def test_nothing_jumps_where_the_goal_changes(seed):
    course, _, _ = chased(seed)
    assert_smooth(course, count=1500)


@pytest.mark.parametrize("seed", SEEDS)
def test_left_alone_it_rests_at_its_last_goal(seed):
    course, _, _ = chased(seed, ended=False)
    rest = course.state(course.settles_at_s)
    np.testing.assert_allclose(rest.position, course.goal, atol=1e-9)
    np.testing.assert_allclose(rest.velocity, 0, atol=1e-12)
    assert course.duration_s == math.inf


@pytest.mark.parametrize("seed", SEEDS)
def test_once_ended_it_rests_for_good(seed):
    course, _, _ = chased(seed)
    assert math.isfinite(course.duration_s)
    for time_s in (course.duration_s, course.duration_s + 1.0, 1e9):
        np.testing.assert_allclose(course.state(time_s).velocity, 0, atol=1e-12)
        np.testing.assert_allclose(course.state(time_s).position, course.goal, atol=1e-12)


def test_not_aimed_at_anything_it_stays():
    course = OnlineTrajectory([0.1, 0.2, 0.3], PACES)
    np.testing.assert_array_equal(course.state(5.0).position, [0.1, 0.2, 0.3])


def test_one_goal_is_reached_as_fast_as_by_a_move():
    course = OnlineTrajectory(np.zeros(3), PACES)
    course.retarget([1.0, 0.5, -0.7], 2.0)
    assert course.settles_at_s == pytest.approx(
        2.0 + JointMove(np.zeros(3), course.goal, PACES).duration_s
    )


def test_the_same_goal_again_and_again_changes_nothing():
    once, often = OnlineTrajectory(np.zeros(3), PACES), OnlineTrajectory(np.zeros(3), PACES)
    once.retarget([1.0, 0.5, -0.7], 0.0)
    for time_s in np.arange(0.0, 1.0, 0.01):
        often.retarget([1.0, 0.5, -0.7], float(time_s))
    np.testing.assert_array_equal(often.state(1.1).position, once.state(1.1).position)


def test_joints_arrive_together_also_from_the_middle_of_a_motion():
    course = OnlineTrajectory(np.zeros(3), PACES)
    course.retarget([1.0, 0.5, -0.7], 0.0)
    course.retarget([-0.3, 0.4, 0.1], 0.4)
    before = course.state(course.settles_at_s - 0.02)
    assert (np.abs(before.position - course.goal) > 1e-8).all()


def test_a_goal_past_a_limit_becomes_the_limit():
    course = OnlineTrajectory(np.zeros(3), PACES, lower=[-1, -1, -1], upper=[1, 1, 1])
    np.testing.assert_array_equal(course.retarget([5, 0, -5], 0.0), [1, 0, -1])
    np.testing.assert_array_equal(course.goal, [1, 0, -1])


def test_a_joint_that_begins_outside_may_be_led_back_and_not_out_again():
    course = OnlineTrajectory([1.1, 0, 0], PACES, lower=[-1, -1, -1], upper=[1, 1, 1])
    np.testing.assert_array_equal(course.state(3.0).position, [1.1, 0, 0])
    np.testing.assert_array_equal(course.retarget([1.05, 0, 0], 3.0), [1, 0, 0])


def test_it_takes_over_a_motion_and_brings_it_to_rest():
    move = JointMove(np.zeros(3), [1.0, 0.5, -0.7], PACES)
    course = OnlineTrajectory(move.state(0.5), PACES)
    np.testing.assert_allclose(course.state(0.0).velocity, move.state(0.5).velocity)
    np.testing.assert_allclose(course.state(course.settles_at_s).velocity, 0, atol=1e-12)


def test_a_motion_that_cannot_stop_inside_the_limits_is_not_taken_over():
    fast = TrajectoryPoint(np.zeros(3), np.array([1.0, 0, 0]), np.zeros(3))
    with pytest.raises(RefusedError, match="too fast"):
        OnlineTrajectory(fast, PACES, lower=[-1, -1, -1], upper=[0.01, 1, 1])


@pytest.mark.parametrize("goal", [[1, 2], [1, 2, math.nan], [math.inf, 0, 0], "here"])
def test_a_goal_that_is_no_joint_vector_is_refused_and_the_old_one_stays(goal):
    course = OnlineTrajectory(np.zeros(3), PACES)
    course.retarget([1, 0, 0], 0.0)
    with pytest.raises(BadValueError, match="The goal"):
        course.retarget(goal, 0.1)
    np.testing.assert_array_equal(course.goal, [1, 0, 0])


@pytest.mark.parametrize("time_s", [0.4, -1.0, math.nan, math.inf])
@pytest.mark.parametrize("what", ["aim", "end"])
def test_time_does_not_go_back(time_s, what):
    course = OnlineTrajectory(np.zeros(3), PACES)
    course.retarget([1, 0, 0], 0.5)
    with pytest.raises(BadValueError, match="time of the goal"):
        course.retarget([0, 0, 0], time_s) if what == "aim" else course.stop(time_s)


def test_another_goal_is_turned_to_at_once_and_not_when_the_old_one_is_reached():
    course = OnlineTrajectory(np.zeros(3), PACES)
    course.retarget([1.0, 0, 0], 0.0)
    old_end_s = course.settles_at_s
    course.retarget([0.3, 0, 0], 0.5 * old_end_s)
    assert course.state(old_end_s).position[0] < 0.9


def test_ended_in_mid_motion_it_comes_to_rest_before_its_goal():
    course = OnlineTrajectory(np.zeros(3), PACES)
    course.retarget([1.0, 0, 0], 0.0)
    goal_s = course.settles_at_s
    course.stop(0.4 * goal_s)
    assert course.duration_s < goal_s
    assert course.goal[0] < 0.9


def test_where_braking_at_once_would_pass_a_limit_it_comes_to_rest_where_it_was_going():
    course = OnlineTrajectory(np.zeros(3), PACES, lower=[-1, -1, -1], upper=[1, 1, 1])
    course.retarget([1.0, 0, 0], 0.0)
    goal_s = course.settles_at_s
    course.set_limits(
        [KinematicLimits(1.0, 0.3, 3.0), *PACES[1:]]
    )  # these could not stop it before the limit
    course.stop(0.7 * goal_s)
    assert course.duration_s == goal_s
    assert_inside(course, [-1, -1, -1], [1, 1, 1])


def test_what_has_ended_is_not_aimed_again():
    course = OnlineTrajectory(np.zeros(3), PACES)
    course.stop(1.0)
    course.stop(2.0)
    assert course.duration_s == 1.0
    with pytest.raises(RefusedError, match="ended"):
        course.retarget([1, 0, 0], 3.0)


@pytest.mark.parametrize("limits", [{"lower": [1, 1, 1], "upper": [0, 2, 2]}, {"lower": [0, 0]},
                                    {"upper": [math.nan, 1, 1]}])  # fmt: skip
def test_limits_that_are_none_are_refused(limits):
    with pytest.raises(BadValueError, match="limits"):
        OnlineTrajectory(np.zeros(3), PACES, **limits)


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(100, 600))
def test_many_chases_keep_every_law(seed):
    course, lower, upper = chased(seed, aims=20)
    assert_keeps_paces(course, PACES, count=3000)
    assert_inside(course, lower, upper, count=3000)
    assert_smooth(course, count=3000)


def test_a_path_that_a_check_refuses_is_not_taken():
    course = OnlineTrajectory(np.zeros(3), PACES)
    course.retarget([0.5, 0.0, 0.0], 0.0)

    def object_to(move):
        raise RefusedError(f"it goes to {move.goal[1]}", "")

    with pytest.raises(RefusedError, match=r"it goes to 0\.3"):
        course.retarget([0.0, 0.3, 0.0], 0.4, object_to)
    np.testing.assert_allclose(course.goal, [0.5, 0.0, 0.0])

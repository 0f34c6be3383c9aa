"""A joint that does not follow is named after three cycles, not before."""

import numpy as np
import pytest

from ikservo.errors import RefusedError
from ikservo.guard import TrackingMonitor
from tests.guard.gates import TICK, make_limits

MOST = np.array([0.2, 0.2])
GOALS = np.array([1.0, 1.0])
LATE = np.array([0.79, 1.0])
FINE = np.array([0.81, 1.0])


def following():
    return TrackingMonitor(["elbow", "wrist"], MOST)


def test_the_third_cycle_in_a_row_stops_the_motion_and_names_the_joint():
    watch = following()
    watch.update(GOALS, LATE)
    watch.update(GOALS, LATE)
    with pytest.raises(RefusedError, match="elbow does not follow"):
        watch.update(GOALS, LATE)


def test_a_cycle_in_time_between_two_late_ones_restarts_the_count():
    watch = following()
    for measured in (LATE, LATE, FINE, LATE, LATE):
        watch.update(GOALS, measured)


def test_exactly_as_far_as_allowed_is_allowed():
    watch = following()
    for _ in range(10):
        watch.update(np.zeros(2), -MOST)


def test_after_a_cycle_in_time_the_third_late_one_stops_the_motion():
    watch = following()
    for measured in (LATE, FINE, LATE, LATE):
        watch.update(GOALS, measured)
    with pytest.raises(RefusedError):
        watch.update(GOALS, LATE)


@pytest.mark.parametrize("measured", [(1.21, 1.0), (1.0, np.nan), (np.inf, 1.0)])
def test_ahead_of_the_goal_and_nowhere_at_all_are_as_bad_as_behind(measured):
    watch = following()
    for _ in range(2):
        watch.update(GOALS, np.array(measured))
    with pytest.raises(RefusedError, match="does not follow"):
        watch.update(GOALS, np.array(measured))


def test_all_that_do_not_follow_are_named():
    watch = following()
    for _ in range(2):
        watch.update(GOALS, GOALS - 1.0)
    with pytest.raises(RefusedError, match="elbow, wrist does not follow"):
        watch.update(GOALS, GOALS - 1.0)


def test_joints_are_counted_each_for_itself():
    watch = following()
    for measured in ((0.7, 1.0), (1.0, 0.7), (0.7, 1.0), (1.0, 0.7)):
        watch.update(GOALS, np.array(measured))


def steps_until_stopped(watch, behind):
    goals = np.zeros(2)
    for cycle in range(1, 6):
        try:
            watch.update(goals, np.array([behind * TICK, 0.0]))
        except RefusedError:
            return cycle
    return None


def test_over_a_look_ahead_nine_tenths_of_it_are_too_far():
    driven_joints = [make_limits(), make_limits("wrist", 4)]  # a look-ahead of 138 ticks
    assert steps_until_stopped(TrackingMonitor.for_limits(driven_joints), 124) is None
    assert steps_until_stopped(TrackingMonitor.for_limits(driven_joints), 125) == 3


def test_a_slow_motion_is_watched_more_closely():
    driven_joints = [make_limits(), make_limits("wrist", 4)]
    slow = {"elbow": 284 * TICK}  # a look-ahead of 106 ticks
    assert steps_until_stopped(TrackingMonitor.for_limits(driven_joints, slow), 95) is None
    assert steps_until_stopped(TrackingMonitor.for_limits(driven_joints, slow), 96) == 3
    assert (
        steps_until_stopped(TrackingMonitor.for_limits(driven_joints, {"wrist": 284 * TICK}), 96)
        is None
    )


def test_a_joint_is_named_by_its_limits():
    watch = TrackingMonitor.for_limits([make_limits("elbow"), make_limits("wrist", 4)])
    for _ in range(2):
        watch.update(np.zeros(2), np.array([0.0, 1.0]))
    with pytest.raises(RefusedError, match=r"^wrist does not"):
        watch.update(np.zeros(2), np.array([0.0, 1.0]))

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


def test_third_following_error_in_a_row_stops_motion():
    watch = following()
    watch.update(GOALS, LATE)
    watch.update(GOALS, LATE)
    with pytest.raises(RefusedError, match="elbow does not follow"):
        watch.update(GOALS, LATE)


def test_cycle_without_following_error_restarts_count():
    watch = following()
    for measured in (LATE, LATE, FINE, LATE, LATE):
        watch.update(GOALS, measured)


def test_following_error_at_exact_maximum_is_allowed():
    watch = following()
    for _ in range(10):
        watch.update(np.zeros(2), -MOST)


def test_third_following_error_after_restart_stops_motion():
    watch = following()
    for measured in (LATE, FINE, LATE, LATE):
        watch.update(GOALS, measured)
    with pytest.raises(RefusedError):
        watch.update(GOALS, LATE)


@pytest.mark.parametrize("measured", [(1.21, 1.0), (1.0, np.nan), (np.inf, 1.0)])
def test_joint_ahead_of_goal_or_nan_is_a_following_error(measured):
    watch = following()
    for _ in range(2):
        watch.update(GOALS, np.array(measured))
    with pytest.raises(RefusedError, match="does not follow"):
        watch.update(GOALS, np.array(measured))


def test_following_error_names_all_lagging_joints():
    watch = following()
    for _ in range(2):
        watch.update(GOALS, GOALS - 1.0)
    with pytest.raises(RefusedError, match="elbow, wrist do not follow"):
        watch.update(GOALS, GOALS - 1.0)


def test_following_error_is_counted_per_joint():
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


def test_following_error_limit_is_90_percent_of_max_lead():
    driven_joints = [make_limits(), make_limits("wrist", 4)]  # a look-ahead of 138 ticks
    assert steps_until_stopped(TrackingMonitor.for_limits(driven_joints), 124) is None
    assert steps_until_stopped(TrackingMonitor.for_limits(driven_joints), 125) == 3


def test_following_error_limit_is_smaller_for_slow_motion():
    driven_joints = [make_limits(), make_limits("wrist", 4)]
    slow = [284 * TICK, driven_joints[1].speed]  # a look-ahead of 106 ticks
    assert steps_until_stopped(TrackingMonitor.for_limits(driven_joints, slow), 95) is None
    assert steps_until_stopped(TrackingMonitor.for_limits(driven_joints, slow), 96) == 3
    assert steps_until_stopped(TrackingMonitor.for_limits(driven_joints, slow[::-1]), 96) is None


def test_following_error_uses_joint_name_of_its_limits():
    watch = TrackingMonitor.for_limits([make_limits("elbow"), make_limits("wrist", 4)])
    for _ in range(2):
        watch.update(np.zeros(2), np.array([0.0, 1.0]))
    with pytest.raises(RefusedError, match=r"^wrist does not"):
        watch.update(np.zeros(2), np.array([0.0, 1.0]))

"""Feedback of tracking errors: proportional, braking, bounded, and kept while goals are cut."""

import numpy as np
import pytest

from ikservo.control.tracking_feedback import TrackingFeedback

CYCLE_S = 0.005


@pytest.fixture
def feedback():
    return TrackingFeedback(np.ones(1))


def fed(feedback, errors, *, grow=True):
    """Return the offsets after each of these errors."""
    offsets = []
    for error in errors:
        feedback.update(np.array([error]), CYCLE_S, grow=grow)
        offsets.append(float(feedback.offset[0]))
    return offsets


def test_a_lag_is_answered_at_once_and_more_the_longer_it_lasts(feedback):
    offsets = fed(feedback, [0.01] * 100)
    assert offsets[0] == pytest.approx(0.5 * 0.01, rel=0.05)
    assert offsets[-1] == pytest.approx(0.5 * 0.01 + 3.0 * 0.01 * 0.5, rel=0.05)


def test_a_joint_that_runs_ahead_is_braked_before_its_error_changes_sides(feedback):
    offsets = fed(feedback, np.linspace(0.01, 0.0, 20))
    assert offsets[-1] < 0.0


def test_while_goals_are_cut_no_part_grows(feedback):
    before = fed(feedback, [0.01] * 10)[-1]
    assert max(fed(feedback, np.linspace(0.01, 0.1, 50), grow=False)) <= before
    assert fed(feedback, [-0.01], grow=False)[0] < before


def test_the_integral_outlasts_a_motion_and_not_torque(feedback):
    fed(feedback, [0.01] * 100)
    integral = feedback.integral.copy()
    feedback.begin()
    np.testing.assert_array_equal(feedback.offset, integral)
    feedback.reset()
    np.testing.assert_array_equal(feedback.offset, 0.0)

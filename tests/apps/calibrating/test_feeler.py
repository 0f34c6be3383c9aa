"""A stop is found only if a joint is still, behind its goal, and pressing."""

import math

import pytest

from ikservo.apps.calibrating.range_tracker import ContactState, EndStopDetector

AHEAD, LOUD = 0.13, 28.0  # rad that the goal leads, and percent of 30
FAR = 0.12  # rad from which a servo presses as hard as it may


def after(samples, most_percent=30.0):
    """Return the feeler's state after samples (s, rad, goal, percent)."""
    feeler = EndStopDetector(most_percent, FAR)
    for sample in samples:
        feeler = feeler.update_with_load(*sample)
    return feeler.contact


def standing(seconds, goal=AHEAD, load=LOUD):
    return [(0.02 * k, 0.0, goal, load) for k in range(int(seconds / 0.02) + 1)]


def test_loaded_joint_at_rest_short_of_goal_is_at_end_stop():
    assert after(standing(0.3)) is ContactState.STOP


def test_joint_at_rest_for_only_200_ms_is_not_at_end_stop():
    assert after(standing(0.2)) is ContactState.MOVING


def test_joint_creeping_under_load_is_not_at_end_stop():
    creeping = [(0.02 * k, 0.001 * k, AHEAD + 0.001 * k, LOUD) for k in range(100)]
    assert after(creeping) is ContactState.MOVING


def test_joint_at_its_goal_is_not_at_end_stop():
    assert after(standing(1.0, goal=0.01)) is ContactState.MOVING


@pytest.mark.parametrize("sign", [1, -1])
def test_end_stop_is_detected_in_both_directions(sign):
    assert after(standing(0.3, goal=sign * AHEAD, load=sign * LOUD)) is ContactState.STOP


def test_joint_held_by_friction_is_not_at_end_stop():
    stuck = [(0.02 * k, 0.0, min(0.01 * k, 0.11), LOUD) for k in range(50)]
    assert after(stuck) is ContactState.MOVING


def test_unloaded_joint_at_rest_is_not_a_contact():
    assert after(standing(1.0, load=2.0)) is ContactState.MOVING
    assert after(standing(1.6, load=2.0)) is ContactState.NO_CONTACT


def test_end_stop_load_threshold_scales_with_torque_limit():
    assert after(standing(0.3, load=14.0), most_percent=60.0) is ContactState.MOVING
    assert after(standing(0.3, load=14.0), most_percent=30.0) is ContactState.STOP


def test_joint_vibrating_by_one_tick_is_at_rest():
    trembling = [(0.02 * k, math.tau / 4096 * (k % 2), AHEAD, LOUD) for k in range(20)]
    assert after(trembling) is ContactState.STOP


def samples(*rows, most_percent=64.0):
    """Return a feeler after samples (s, rad) of a joint that presses with half its torque limit."""
    feeler = EndStopDetector(most_percent, FAR)
    for at_s, at_rad in rows:
        feeler = feeler.update_with_load(at_s, at_rad, at_rad + AHEAD, 32.0)
    return feeler


@pytest.mark.parametrize(
    ("last_s", "touch"), [(5.25, ContactState.STOP), (5.24, ContactState.MOVING)]
)
def test_end_stop_detection_waits_250_ms_after_last_motion(last_s, touch):
    assert samples((4.0, 0.0), (5.0, 1.0), (last_s, 1.0)).contact is touch


def test_first_sample_does_not_detect_end_stop():
    assert not EndStopDetector(30.0, FAR).may_be_blocked(7.0, 0.0, 1.0)
    assert samples((7.0, 0.0)).contact is ContactState.MOVING


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(("step_rad", "stands"), [(0.00401, False), (0.004, True), (0.0039, True)])
def test_position_change_below_three_ticks_is_not_motion(way, step_rad, stands):
    seen = samples((0.0, 0.0), (0.25, way * step_rad))
    assert (seen.contact is ContactState.STOP) is stands
    assert samples((0.0, 1.0), (0.25, 1.0 + way * 0.01)).blocked.joints == [1.0 + way * 0.01]


@pytest.mark.parametrize("way", [1, -1])
@pytest.mark.parametrize(("behind_rad", "stop"), [(0.12, True), (0.1199, False)])
def test_end_stop_needs_lag_of_0_12_rad_behind_goal(way, behind_rad, stop):
    feeler = (
        EndStopDetector(64.0, FAR)
        .update_with_load(0.0, 0.0, 0.0, 0.0)
        .update_with_load(0.25, 0.0, way * behind_rad, 32.0)
    )
    assert (feeler.contact is ContactState.STOP) is stop


def test_end_stop_lag_is_measured_from_resting_position():
    feeler = (
        EndStopDetector(64.0, FAR)
        .update_with_load(0.0, 1.0, 1.02, 32.0)
        .update_with_load(0.25, 1.0, 1.02, 32.0)
    )
    assert feeler.contact is ContactState.MOVING


@pytest.mark.parametrize(("load", "stop"), [(25.6, True), (25.5, False), (-25.6, True)])
def test_end_stop_needs_load_of_two_fifths_of_torque_limit(load, stop):
    feeler = (
        EndStopDetector(64.0, FAR)
        .update_with_load(0.0, 0.0, 1.0, load)
        .update_with_load(0.25, 0.0, 1.0, load)
    )
    assert (feeler.contact is ContactState.STOP) is stop


@pytest.mark.parametrize(
    ("stood_s", "touch"), [(1.5, ContactState.NO_CONTACT), (1.49, ContactState.MOVING)]
)
def test_unloaded_joint_at_rest_1500_ms_is_not_a_contact(stood_s, touch):
    feeler = (
        EndStopDetector(64.0, FAR)
        .update_with_load(4.0, 0.0, 1.0, 0.0)
        .update_with_load(4.0 + stood_s, 0.0, 1.0, 0.0)
    )
    assert feeler.contact is touch

"""A recorded motion as a trajectory: within its limits, and close to the recording."""

import numpy as np
import pytest

from ikservo.apps.teaching.replaying import RecordedTrajectory
from ikservo.motion import KinematicLimits

TICK = 2 * np.pi / 4096
PACES = [KinematicLimits(1.0, 3.0, 30.0), KinematicLimits(2.0, 6.0, 60.0)]
FREE = np.array([-10.0, -10.0]), np.array([10.0, 10.0])
TIMES_S = np.arange(0.0, 6.0, 0.02)


def wave(speed=1.0):
    """Return a motion of two joints in whole ticks, as servos report it."""
    phase = speed * TIMES_S
    joints = np.column_stack([0.4 * np.sin(phase), 0.3 * np.cos(1.5 * phase)])
    return np.round(joints / TICK) * TICK


def states(playback):
    times_s = np.linspace(0.0, playback.duration_s, 3000)
    return times_s, [playback.state(t) for t in times_s]


@pytest.mark.parametrize("speed", [0.3, 1.0, 6.0, 40.0])
def test_replay_stays_within_speed_limits_of_joints(speed):
    times_s, seen = states(RecordedTrajectory(TIMES_S, wave(speed), PACES, *FREE))
    jerk = np.abs(np.diff([s.acceleration for s in seen], axis=0)).max(axis=0) / times_s[1]
    for i, pace in enumerate(PACES):
        assert max(abs(s.velocity[i]) for s in seen) <= pace.speed_rad_s
        assert max(abs(s.acceleration[i]) for s in seen) <= pace.acceleration_rad_s2
        assert jerk[i] <= pace.jerk_rad_s3


def test_replay_starts_and_ends_at_rest():
    playback = RecordedTrajectory(TIMES_S, wave(), PACES, *FREE)
    for time_s in (0.0, playback.duration_s, playback.duration_s + 1.0):
        assert np.abs(playback.state(time_s).velocity).max() < 1e-9


def test_replay_passes_through_recorded_samples():
    recorded = wave()
    _, seen = states(RecordedTrajectory(TIMES_S, recorded, PACES, *FREE))
    path = np.array([s.position for s in seen])
    for sample in recorded[::10]:
        assert np.abs(path - sample).max(axis=1).min() < 0.01


def test_recording_within_joint_limits_is_not_slowed_down():
    playback = RecordedTrajectory(TIMES_S, wave(0.3), PACES, *FREE)
    assert playback.slowdown == 1.0
    assert playback.duration_s == pytest.approx(TIMES_S[-1], abs=1.5)


def test_fast_recording_reports_its_slowdown():
    assert RecordedTrajectory(TIMES_S, wave(40.0), PACES, *FREE).slowdown > 5.0


def test_replay_stays_inside_joint_limits():
    lower, upper = np.array([-0.3, -0.2]), np.array([0.3, 0.2])
    _, seen = states(RecordedTrajectory(TIMES_S, wave(), PACES, lower, upper))
    path = np.array([s.position for s in seen])
    assert (path >= lower).all()
    assert (path <= upper).all()


def test_replayed_positions_have_no_jump():
    times_s, seen = states(RecordedTrajectory(TIMES_S, wave(6.0), PACES, *FREE))
    steps = np.abs(np.diff([s.position for s in seen], axis=0)).max(axis=0)
    assert (steps <= [1.0 * times_s[1] + 1e-9, 2.0 * times_s[1] + 1e-9]).all()


def test_recording_with_one_sample_is_a_fixed_position():
    playback = RecordedTrajectory(np.array([0.0]), np.array([[0.1, 0.2]]), PACES, *FREE)
    assert playback.duration_s == 0.0
    np.testing.assert_array_equal(playback.state(0.0).position, [0.1, 0.2])
    np.testing.assert_array_equal(playback.sample_path(), [[0.1, 0.2]])


@pytest.mark.parametrize("span_s", [5e-324, 1e-9, 0.019])
def test_recording_shorter_than_20_ms_is_a_fixed_position(span_s):
    playback = RecordedTrajectory(
        np.array([0.0, span_s]), np.array([[0.3, 0.2], [0.1, 0.2]]), PACES, *FREE
    )
    assert playback.duration_s == 0.0
    np.testing.assert_array_equal(playback.start, [0.1, 0.2])


def test_replay_path_is_sampled_in_small_steps():
    playback = RecordedTrajectory(TIMES_S, wave(), PACES, *FREE)
    way = playback.sample_path()
    assert np.abs(np.diff(way, axis=0)).max() < 0.1
    np.testing.assert_allclose(way[0], playback.start)
    np.testing.assert_allclose(way[-1], playback.state(playback.duration_s).position)

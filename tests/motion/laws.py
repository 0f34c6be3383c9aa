"""Laws that every motion must keep, shared by its tests."""

import numpy as np


def sampled(course, count=400, until_s=None):
    """Return times (count,), positions, velocities and accelerations (count, n)."""
    times_s = np.linspace(0.0, course.duration_s if until_s is None else until_s, count)
    states = [course.state(time_s) for time_s in times_s]
    parts = [np.array([getattr(s, name) for s in states])
             for name in ("position", "velocity", "acceleration")]  # fmt: skip
    return times_s, *parts


def assert_keeps_paces(course, paces, count=400, until_s=None):
    """Check speed and acceleration at every instant, and jerk between any two instants."""
    times_s, _, velocity, acceleration = sampled(course, count, until_s)
    jerk = np.diff(acceleration, axis=0) / max(times_s[1] - times_s[0], 1e-9)
    for found, name in (
        (velocity, "speed_rad_s"),
        (acceleration, "acceleration_rad_s2"),
        (jerk, "jerk_rad_s3"),
    ):
        most = np.array([getattr(pace, name) for pace in paces])
        worst = np.abs(found).max(axis=0) / most
        assert (worst <= 1 + 1e-6).all(), f"{name}: {worst.max():.6f} of what is allowed"


def assert_inside(course, lower, upper, count=400, until_s=None):
    """Check that positions are inside limits at every instant."""
    _, position, _, _ = sampled(course, count, until_s)
    assert (position >= np.asarray(lower) - 1e-6).all()
    assert (position <= np.asarray(upper) + 1e-6).all()


def assert_smooth(course, count=400, until_s=None):
    """Check that position and velocity are the integrals of velocity and acceleration."""
    times_s, position, velocity, acceleration = sampled(course, count, until_s)
    step_s = times_s[1] - times_s[0]
    for value, slope in ((position, velocity), (velocity, acceleration)):
        grown = step_s * (slope[1:] + slope[:-1]) / 2
        bend = np.abs(np.diff(slope, axis=0)).max() * step_s
        np.testing.assert_allclose(np.diff(value, axis=0), grown, atol=bend + 1e-9)

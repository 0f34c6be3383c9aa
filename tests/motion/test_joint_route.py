"""Motions through waypoints without a stop: inside speed limits, near every point."""

import math
from itertools import pairwise

import numpy as np
import pytest

from ikservo.errors import BadValueError
from ikservo.motion import JointMove, JointWaypointTrajectory, KinematicLimits
from tests.motion.laws import assert_inside, assert_keeps_paces, assert_smooth, sampled

PACES = [
    KinematicLimits(1.0, 3.0, 30.0),
    KinematicLimits(0.4, 5.0, 40.0),
    KinematicLimits(2.0, 6.0, 90.0),
]
SEEDS = range(5)


def points_of(seed):
    rng = np.random.default_rng(seed)
    return rng.uniform(-1.5, 1.5, (int(rng.integers(2, 6)), 3))


def route_of(seed, blend=0.2):
    return JointWaypointTrajectory(np.zeros(3), points_of(seed), PACES, blend)


@pytest.mark.parametrize("seed", SEEDS)
def test_waypoint_trajectory_keeps_kinematic_limits(seed):
    assert_keeps_paces(route_of(seed), PACES, count=1200)


@pytest.mark.parametrize("seed", SEEDS)
def test_waypoint_trajectory_has_no_jumps(seed):
    assert_smooth(route_of(seed), count=1200)


@pytest.mark.parametrize("seed", SEEDS)
def test_waypoint_trajectory_stays_in_range_of_its_waypoints(seed):
    corners = np.vstack([np.zeros(3), points_of(seed)])
    assert_inside(route_of(seed), corners.min(axis=0), corners.max(axis=0), count=800)


@pytest.mark.sample(4)
@pytest.mark.parametrize("blend", [0.02, 0.2])
@pytest.mark.parametrize("seed", SEEDS)
def test_waypoints_are_passed_within_blend(seed, blend):
    _, position, _, _ = sampled(route_of(seed, blend), 4000)
    for point in points_of(seed):
        assert np.abs(position - point).max(axis=1).min() <= 0.375 * blend + 2e-3


@pytest.mark.parametrize("seed", SEEDS)
def test_waypoint_trajectory_stops_only_at_its_end(seed):
    route = route_of(seed)
    _, _, velocity, _ = sampled(route, 400)
    inner = velocity[20:-20]
    assert (np.abs(inner).max(axis=1) > 1e-3).all()
    np.testing.assert_allclose(route.state(route.duration_s).velocity, 0, atol=1e-9)
    np.testing.assert_allclose(route.at(route.duration_s), points_of(seed)[-1], atol=1e-9)


@pytest.mark.parametrize("seed", SEEDS)
def test_waypoint_trajectory_is_hardly_slower_than_with_stops(seed):
    corners = [np.zeros(3), *points_of(seed)]
    stopping = sum(JointMove(a, b, PACES).duration_s for a, b in pairwise(corners))
    assert route_of(seed).duration_s <= 1.15 * stopping


def test_trajectory_to_single_waypoint_is_as_fast_as_joint_move():
    alike = [PACES[0]] * 3
    route = JointWaypointTrajectory(np.zeros(3), [[1.0, 0.5, -0.7]], alike, 0.1)
    move = JointMove(np.zeros(3), [1.0, 0.5, -0.7], alike)
    assert route.duration_s == pytest.approx(move.duration_s, rel=0.01)


def test_waypoint_trajectory_there_and_back_reaches_waypoint():
    route = JointWaypointTrajectory(np.zeros(3), [[1.0, 0.2, 0.4], [0.0, 0.0, 0.0]], PACES, 0.1)
    _, position, _, _ = sampled(route, 2000)
    assert position[:, 0].max() == pytest.approx(1.0, abs=0.0376)
    assert_keeps_paces(route, PACES, count=1200)


def test_repeated_waypoint_is_used_once():
    twice = JointWaypointTrajectory(
        np.zeros(3), [[1.0, 0, 0], [1.0, 0, 0], [1.0, 0.5, 0]], PACES, 0.1
    )
    once = JointWaypointTrajectory(np.zeros(3), [[1.0, 0, 0], [1.0, 0.5, 0]], PACES, 0.1)
    assert twice.duration_s == pytest.approx(once.duration_s)


def test_waypoint_trajectory_to_its_start_takes_no_time():
    assert (
        JointWaypointTrajectory(np.zeros(3), [np.zeros(3), np.zeros(3)], PACES, 0.1).duration_s
        == 0.0
    )


@pytest.mark.parametrize("blend", [0.0, -1.0, math.nan, math.inf])
def test_blend_must_be_positive_and_finite(blend):
    with pytest.raises(BadValueError, match="blend"):
        JointWaypointTrajectory(np.zeros(3), [np.ones(3), np.zeros(3)], PACES, blend)


@pytest.mark.parametrize(
    ("points", "blends"), [([], 0.1), ([[1, 2]], 0.1), ([[1, 2, math.nan]], 0.1),
                           ([[1, 2, 3], [0, 0, 0]], [0.1, 0.1])])  # fmt: skip
def test_invalid_waypoints_or_blends_are_refused(points, blends):
    with pytest.raises(BadValueError):
        JointWaypointTrajectory(np.zeros(3), points, PACES, blends)

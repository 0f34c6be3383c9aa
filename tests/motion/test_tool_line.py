"""Straight motion of the tool within joint limits; impossible lines are refused beforehand."""

import math
from functools import cache

import numpy as np
import pytest

from ikservo.errors import BadValueError, CartesianPathError
from ikservo.ik import Target, solve
from ikservo.kinematics.se3 import log_so3
from ikservo.model import load_model
from ikservo.motion import CartesianTrajectory, JointMove, KinematicLimits, straight_lines
from tests.motion.laws import assert_inside, assert_keeps_paces, assert_smooth, sampled
from tests.oracle import ARMS

MODEL = load_model("so101")
CHAIN = MODEL.chain
HOME = MODEL.chain_pose("home")
PACES = [KinematicLimits(1.0, 3.0, 30.0)] * CHAIN.dof
FROM = CHAIN.forward(HOME)[:3, 3]
TOGETHER = [(name, seed) for name in ARMS for seed in range(1)]


def tool_line(chain, q, points_m, paces, blend_m=0.02, **kwargs):
    """Return the motion of the tip along lines through points."""
    path = straight_lines(chain.forward(q)[:3, 3], points_m, blend_m)
    return CartesianTrajectory(chain, q, path, paces, **kwargs)


def line(dx=0.0, dy=0.1, dz=0.05, **kwargs):
    return tool_line(CHAIN, HOME, [FROM + np.array([dx, dy, dz])], PACES, **kwargs)


@cache
def seeded(name, seed):
    """Return an arm's chain and a random line that its tool can follow."""
    model, rng = load_model(name), np.random.default_rng(seed)
    chain = model.chain
    while True:
        q = chain.clip(model.chain_pose("home") + rng.normal(0.0, 0.25, chain.dof))
        way_m = rng.normal(size=3) * (1.0, 1.0, 0.0 if name.startswith("planar") else 1.0)
        goal_m = chain.forward(q)[:3, 3] + rng.uniform(0.02, 0.2) * way_m / np.linalg.norm(way_m)
        try:
            return chain, tool_line(chain, q, [goal_m], [PACES[0]] * chain.dof)
        except CartesianPathError:
            continue


def strays_m(chain, motion):
    """Return the distances of the tip from the straight line between its ends."""
    _, joints, _, _ = sampled(motion, 1000)
    tips = chain.forward(joints)[:, :3, 3]
    along = (tips[-1] - tips[0]) / np.linalg.norm(tips[-1] - tips[0])
    gone = tips - tips[0]
    return np.linalg.norm(gone - np.outer(gone @ along, along), axis=1)


@pytest.mark.sample(8)
@pytest.mark.parametrize(("name", "seed"), TOGETHER)
def test_tool_line_keeps_tip_within_0_5_mm_of_straight_line(name, seed):
    assert strays_m(*seeded(name, seed)).max() < 5e-4


@pytest.mark.sample(8)
@pytest.mark.parametrize(("name", "seed"), TOGETHER)
def test_tool_line_keeps_kinematic_limits(name, seed):
    chain, motion = seeded(name, seed)
    assert_keeps_paces(motion, [PACES[0]] * chain.dof, count=1000)


@pytest.mark.sample(8)
@pytest.mark.parametrize(("name", "seed"), TOGETHER)
def test_tool_line_keeps_joint_limits_and_has_no_jumps(name, seed):
    chain, motion = seeded(name, seed)
    assert_inside(motion, chain.lower_rad, chain.upper_rad)
    assert_smooth(motion, count=1000)


@pytest.mark.campaign
@pytest.mark.parametrize("seed", range(1, 40))
@pytest.mark.parametrize("name", ARMS)
def test_tool_lines_keep_every_limit_in_campaign(name, seed):
    chain, motion = seeded(name, seed)
    assert strays_m(chain, motion).max() < 5e-4
    assert_keeps_paces(motion, [PACES[0]] * chain.dof, count=1000)
    assert_inside(motion, chain.lower_rad, chain.upper_rad)
    assert_smooth(motion, count=1000)


@pytest.mark.parametrize("speed_m_s", [0.02, 0.25, 5.0])
def test_tool_line_tip_never_exceeds_requested_speed(speed_m_s):
    motion = line(speed_m_s=speed_m_s)
    times_s, joints, _, _ = sampled(motion, 800)
    tips = CHAIN.forward(joints)[:, :3, 3]
    speeds = np.linalg.norm(np.diff(tips, axis=0), axis=1) / times_s[1]
    assert speeds.max() <= speed_m_s * 1.001


def test_tool_line_ends_at_goal():
    motion = line()
    np.testing.assert_allclose(CHAIN.forward(motion.goal)[:3, 3],
                               FROM + np.array([0, 0.1, 0.05]), atol=1e-6)  # fmt: skip


@pytest.mark.parametrize("name", ["wx250s", "vx300s"])
def test_six_joint_arm_keeps_full_orientation_on_line(name):
    model = load_model(name)
    chain, q = model.chain, model.chain_pose("home")
    goal_m = chain.forward(q)[:3, 3] + (0.03, 0.1, 0.05)
    motion = tool_line(chain, q, [goal_m], [PACES[0]] * chain.dof)
    turned = chain.forward(motion.goal)[:3, :3] @ chain.forward(q)[:3, :3].T
    assert math.degrees(np.linalg.norm(log_so3(turned))) < 0.1
    assert math.degrees(motion.orientation_error_rad.max()) < 0.1


@pytest.mark.parametrize("name", ["so101", "omx_f", "open_manipulator_x", "px100"])
def test_arm_without_free_wrist_keeps_tool_pitch_on_line(name):
    model = load_model(name)
    chain, q = model.chain, model.chain_pose("home")
    goal_m = chain.forward(q)[:3, 3] + (-0.03, 0.06, 0.02)
    motion = tool_line(chain, q, [goal_m], [PACES[0]] * chain.dof)
    _, joints, _, _ = sampled(motion, 50)
    steep = chain.forward(joints)[:, 2, :3]
    np.testing.assert_allclose(steep, np.tile(steep[0], (50, 1)), atol=2e-3)


def test_tool_line_with_end_orientation_reaches_it():
    model = load_model("wx250s")
    chain, q = model.chain, model.chain_pose("home")
    end = q + np.array([0.1, 0.15, -0.1, 0.1, 0.2, 0.3])
    goal = chain.forward(end)
    motion = tool_line(chain, q, [goal[:3, 3]], [PACES[0]] * chain.dof, end=end)
    there = chain.forward(motion.goal)
    np.testing.assert_allclose(there, goal, atol=1e-4)
    assert_keeps_paces(motion, [PACES[0]] * chain.dof, count=1000)


def test_tool_line_with_end_orientation_rotates_evenly():
    model = load_model("wx250s")
    chain, q = model.chain, model.chain_pose("home")
    end = q + np.array([0.1, 0.15, -0.1, 0.1, 0.2, 0.3])
    goal_m = chain.forward(end)[:3, 3]
    motion = tool_line(chain, q, [goal_m], [PACES[0]] * chain.dof, end=end)
    assert math.degrees(motion.orientation_error_rad.max()) < 0.1


def test_tool_turn_in_place_keeps_tip_position():
    model = load_model("wx250s")
    chain, q = model.chain, model.chain_pose("home")
    end = q + np.array([0, 0, 0, 0, 0, 0.5])
    goal_m = chain.forward(q)[:3, 3]
    motion = tool_line(chain, q, [goal_m], [PACES[0]] * chain.dof, end=end)
    np.testing.assert_allclose(motion.goal, end, atol=1e-3)
    _, joints, _, _ = sampled(motion, 50)
    np.testing.assert_allclose(
        chain.forward(joints)[:, :3, 3], np.tile(chain.forward(q)[:3, 3], (50, 1)), atol=2.5e-4
    )


def test_line_out_of_reach_error_names_last_reachable_point():
    with pytest.raises(CartesianPathError) as caught:
        line(dx=0.5, dy=0.0, dz=0.0)
    error = caught.value
    assert FROM[0] + 0.05 < error.nearest_m[0] < FROM[0] + 0.3
    assert error.target_m[0] - FROM[0] == pytest.approx(error.along_m)
    assert error.binding


def test_line_through_base_axis_is_refused_as_singular():
    model = load_model("open_manipulator_x")
    chain = model.chain
    q = solve(chain, Target((0.06, 0.0, 0.25)), model.chain_pose("home")).q
    with pytest.raises(CartesianPathError, match="singularity") as caught:
        tool_line(chain, q, [(-0.06, 0.0005, 0.25)], [PACES[0]] * chain.dof)
    assert 0.0 < caught.value.along_m < 0.12


def test_line_that_cannot_keep_orientation_is_refused():
    with pytest.raises(CartesianPathError, match="tool would turn") as caught:
        line(0.0, 0.15, 0.0, strict=True)
    assert 0.0 < caught.value.along_m < 0.15


def test_tool_line_of_zero_length_takes_no_time():
    assert line(0, 0, 0).duration_s == pytest.approx(0.0, abs=1e-6)


@pytest.mark.parametrize("speed_m_s", [0.0, -1.0, math.nan, math.inf])
def test_tool_speed_must_be_positive_and_finite(speed_m_s):
    with pytest.raises(BadValueError, match="speed of the tool"):
        line(speed_m_s=speed_m_s)


CORNERS = [FROM + np.array(way_m) for way_m in ((0, 0.08, 0), (0, 0.08, 0.08), (0, -0.05, 0.08))]


@pytest.mark.parametrize("blend_m", [0.005, 0.02, 0.05])
def test_tool_waypoints_are_passed_within_blend(blend_m):
    route = tool_line(CHAIN, HOME, CORNERS, PACES, blend_m=blend_m)
    _, joints, _, _ = sampled(route, 3000)
    tips = CHAIN.forward(joints)[:, :3, 3]
    for corner in CORNERS[:-1]:
        assert np.linalg.norm(tips - corner, axis=1).min() <= 0.375 * blend_m + 5e-4
    np.testing.assert_allclose(tips[-1], CORNERS[-1], atol=1e-5)


def test_tool_waypoint_line_keeps_every_limit():
    route = tool_line(CHAIN, HOME, CORNERS, PACES)
    assert_keeps_paces(route, PACES, count=1500)
    assert_smooth(route, count=1500)
    assert_inside(route, CHAIN.lower_rad, CHAIN.upper_rad)


def test_tool_waypoint_line_stops_only_at_its_end():
    route = tool_line(CHAIN, HOME, CORNERS, PACES)
    _, _, velocity, _ = sampled(route, 400)
    assert (np.abs(velocity[20:-20]).max(axis=1) > 0.01).all()


def test_tool_waypoint_line_is_faster_than_single_lines():
    lines_s, q = 0.0, HOME
    for corner in CORNERS:
        motion = tool_line(CHAIN, q, [corner], PACES)
        lines_s, q = lines_s + motion.duration_s, motion.goal
    assert tool_line(CHAIN, HOME, CORNERS, PACES).duration_s < lines_s


def test_tool_line_takes_under_1_5_times_as_long_as_joint_move():
    motion = line()
    assert motion.duration_s < 1.5 * JointMove(HOME, motion.goal, PACES).duration_s

"""Arcs and circles: their geometry, and the tool that follows them."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ikservo.errors import BadValueError, CartesianPathError
from ikservo.model import load_model
from ikservo.motion import CartesianTrajectory, KinematicLimits
from ikservo.motion.arc import arc_about_axis, arc_through_points
from tests.motion.laws import assert_inside, assert_keeps_paces, assert_smooth, sampled

X, Y = np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0])
MODEL = load_model("so101")
CHAIN, HOME = MODEL.chain, MODEL.chain_pose("home")
FROM = CHAIN.forward(HOME)[:3, 3]
PACES = [KinematicLimits(1.0, 3.0, 30.0)] * CHAIN.dof

coordinates = st.floats(-1.0, 1.0)
points = st.tuples(coordinates, coordinates, coordinates).map(np.array)


def test_half_circle_arc_is_exact():
    arc = arc_through_points(X, Y, -X)
    assert arc.length == pytest.approx(math.pi)
    np.testing.assert_allclose(arc.at(0.0)[0], X, atol=1e-12)
    np.testing.assert_allclose(arc.at(math.pi / 2)[0], Y, atol=1e-12)
    np.testing.assert_allclose(arc.at(math.pi)[0], -X, atol=1e-12)


def test_via_point_determines_direction_of_arc():
    arc = arc_through_points(X, -X, Y)
    assert arc.length == pytest.approx(1.5 * math.pi)
    np.testing.assert_allclose(arc.at(math.pi / 2)[0], -Y, atol=1e-12)


def test_full_circle_passes_three_points_and_returns_to_start():
    arc = arc_through_points(X, Y, -X, full_circle=True)
    assert arc.length == pytest.approx(2 * math.pi)
    np.testing.assert_allclose(arc.at(math.pi)[0], -X, atol=1e-12)
    np.testing.assert_allclose(arc.at(arc.length)[0], X, atol=1e-12)


@pytest.mark.full
@given(start=points, via=points, end=points)
def test_arc_passes_its_three_points_with_unit_speed(start, via, end):
    try:
        arc = arc_through_points(start, via, end)
    except BadValueError:
        return
    along = np.linspace(0.0, arc.length, 2001)
    path = np.array([arc.at(s)[0] for s in along])
    near = 1e-6 + arc.radius_m * 1e-9
    assert np.linalg.norm(path[0] - start) < near
    assert np.linalg.norm(path[-1] - end) < near
    assert np.linalg.norm(path - via, axis=1).min() < arc.length / 2000
    slopes = np.array([np.linalg.norm(arc.at(s)[1]) for s in along])
    np.testing.assert_allclose(slopes, 1.0, rtol=1e-6)


@pytest.mark.parametrize(
    ("via", "end"),
    [
        ((2.0, 0.0, 0.0), (3.0, 0.0, 0.0)),
        ((0.5, 0.0, 0.0), (-1.0, 1e-4, 0.0)),
        ((0.5, 1.9e-4, 0.0), (0.0, 0.0, 0.0)),
        ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0)),
        ((0.0, 1.0, 0.0), (1.0, 0.0, 0.0)),
        ((0.0, 1.0, 0.0), (0.0, 1.0, 0.0)),
    ],
)
def test_collinear_or_equal_points_are_refused_as_arc(via, end):
    with pytest.raises(BadValueError, match=r"on one line|are the same"):
        arc_through_points(X, via, end)


@pytest.mark.parametrize("angle_rad", [0.5, -0.5, 2 * math.pi, -5 * math.pi])
def test_arc_about_axis_turns_by_its_angle(angle_rad):
    arc = arc_about_axis(np.array([1.0, 0.0, 0.3]), (0, 0, 0), (0, 0, 2.0), angle_rad)
    assert arc.length == pytest.approx(abs(angle_rad))
    expected = (math.cos(angle_rad), math.sin(angle_rad), 0.3)
    np.testing.assert_allclose(arc.at(arc.length)[0], expected, atol=1e-12)


@pytest.mark.parametrize(
    ("center", "normal", "angle_rad", "words"),
    [
        ((1, 0, 5), (0, 0, 1), 1.0, "radius of the circle is 0.00 mm"),
        ((0, 0, 0), (0, 0, 0), 1.0, "normal of the circle is zero"),
        ((0, 0, 0), (0, 0, 1), 0.0, "angle of the arc is 0°"),
        ((0, 0, 0), (0, 0, 1), math.nan, "angle of the arc is nan"),
        ((0, 0, 0), (0, 0, 1), 63.0, "up to ten turns"),
        ((0, math.nan, 0), (0, 0, 1), 1.0, "finite"),
    ],
)
def test_invalid_circle_motion_is_refused(center, normal, angle_rad, words):
    with pytest.raises(BadValueError, match=words):
        arc_about_axis(X, center, normal, angle_rad)


def circle(angle_rad=2 * math.pi, **options):
    arc = arc_about_axis(FROM, FROM - (0.03, 0.0, 0.0), (0, 0, 1), angle_rad)
    return CartesianTrajectory(CHAIN, HOME, arc, PACES, **options)


def test_circle_motion_keeps_tip_on_circle_and_joint_limits():
    motion = circle()
    _, joints, _, _ = sampled(motion, 1000)
    gone = CHAIN.forward(joints)[:, :3, 3] - (FROM - (0.03, 0.0, 0.0))
    assert np.abs(np.linalg.norm(gone, axis=1) - 0.03).max() < 5e-4
    assert_keeps_paces(motion, PACES, 2000)
    assert_inside(motion, CHAIN.lower_rad, CHAIN.upper_rad)
    assert_smooth(motion, 2000)


@pytest.mark.parametrize("tool_speed_m_s", [0.01, 0.03])
def test_tool_speed_on_arc_is_constant_between_ramps(tool_speed_m_s):
    motion = circle(tool_speed_m_s=tool_speed_m_s)
    times_s = np.linspace(0.0, motion.duration_s, 4001)
    tips = CHAIN.forward(np.array([motion.at(t) for t in times_s]))[:, :3, 3]
    speeds = np.linalg.norm(np.diff(tips, axis=0), axis=1) / times_s[1]
    cruise = np.flatnonzero(speeds > 0.99 * tool_speed_m_s)
    between = speeds[cruise[0] : cruise[-1] + 1]
    np.testing.assert_allclose(between, tool_speed_m_s, rtol=0.01)
    assert len(between) > 0.6 * len(speeds)


def test_arc_out_of_reach_error_mentions_arc():
    arc = arc_about_axis(FROM, FROM + 0.2 * X, (0, 1, 0), math.pi)
    with pytest.raises(CartesianPathError, match="The arc can be followed only for 0"):
        CartesianTrajectory(CHAIN, HOME, arc, PACES)

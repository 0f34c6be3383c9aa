"""Positions of a slide behind a crank, a rack or a gear are in metres and radians."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ikservo.calibration import Crank, JointMap
from ikservo.errors import BadValueError

CRANK = Crank(radius_m=0.022, rod_m=0.036, zero_rad=math.radians(90))
angles = st.floats(-1.2, 1.2)


@given(angles)
def test_crank_angle_and_slide_position_are_inverses(angle):
    assert CRANK.horn_rad(CRANK.position(angle)) == pytest.approx(angle, abs=1e-9)


@given(angles, st.sampled_from([-1, 1]), st.integers(-800, 800))
def test_crank_ticks_and_metres_are_exact_inverses(angle, sign, tick):
    joint_map = JointMap.cranked("gripper", 5, sign, 2048.0, 4096, CRANK)
    assert joint_map.tick(joint_map.position(2048 + tick)) == 2048 + tick


def test_crank_at_right_angle_moves_slide_by_radius_per_radian():
    slope = (CRANK.position(1e-6) - CRANK.position(-1e-6)) / 2e-6
    assert slope == pytest.approx(0.022, rel=1e-6)


@given(angles)
def test_crank_slope_does_not_exceed_maximum_of_joint_map(angle):
    joint_map = JointMap.cranked("gripper", 5, 1, 2048.0, 4096, CRANK)
    tick = 2048 + angle / joint_map.horn_rad_per_tick
    step = joint_map.position(tick + 1) - joint_map.position(tick)
    assert 0 < step <= joint_map.unit_per_tick * (1 + 1e-3)


def test_positive_sign_means_cranked_slide_opens_with_ticks():
    joint_map = JointMap.cranked("gripper", 5, 1, 2048.0, 4096, CRANK)
    assert joint_map.position(2148) > joint_map.position(2048) == 0.0


@pytest.mark.parametrize(
    ("radius", "rod", "zero"), [(0.04, 0.03, 1), (0, 0.03, 1), (0.02, 0.03, 4)]
)
def test_crank_with_impossible_geometry_is_refused(radius, rod, zero):
    with pytest.raises(BadValueError, match="crank"):
        Crank(radius, rod, zero)


@given(st.floats(0.2, 5.0), st.integers(-4000, 4000))
def test_gear_divides_radians_per_tick_and_stays_exact(gear, tick):
    joint_map = JointMap.revolute("waist", 1, -1, 100.5, 4096, gear)
    assert joint_map.unit_per_tick == pytest.approx(math.tau / 4096 / gear)
    assert joint_map.tick(joint_map.position(tick)) == tick
    assert joint_map.gear == pytest.approx(gear)


def test_potentiometer_servo_tick_is_300_degrees_over_1024():
    joint_map = JointMap.revolute("elbow", 3, 1, 512, 1024 * 360 / 300)
    assert math.degrees(joint_map.unit_per_tick) == pytest.approx(300 / 1024)


def test_cranked_slide_ends_where_pin_and_rod_are_in_line():
    upright_m = math.sqrt(0.036**2 - 0.022**2)
    assert CRANK.position(CRANK.zero_rad) == pytest.approx(0.022 + 0.036 - upright_m)
    assert CRANK.position(CRANK.zero_rad - math.pi) == pytest.approx(0.036 - 0.022 - upright_m)


def test_slide_beyond_its_ends_maps_to_the_dead_centre():
    furthest_m, nearest_m = (CRANK.position(CRANK.zero_rad - angle) for angle in (0.0, math.pi))
    assert CRANK.horn_rad(furthest_m + 0.01) == pytest.approx(CRANK.zero_rad)
    assert CRANK.horn_rad(nearest_m - 0.005) == pytest.approx(CRANK.zero_rad - math.pi)


@pytest.mark.parametrize(("turn", "cut"), [(0.3, 0.3), (9.0, 0.0), (-9.0, -math.pi)])
def test_crank_turn_is_clamped_at_the_dead_centres(turn, cut):
    expected = turn if turn == cut else CRANK.zero_rad + cut
    assert CRANK.clamp_to_dead_centre(turn) == pytest.approx(expected)


def test_crank_max_slope_is_steepest_between_slide_ends():
    crank = Crank(0.02, 0.03, 0.5)
    turns = [crank.zero_rad - math.pi * k / 2000 for k in range(1, 2000)]
    slopes = [(crank.position(t + 1e-6) - crank.position(t - 1e-6)) / 2e-6 for t in turns]
    assert crank.max_m_per_rad == pytest.approx(max(slopes), rel=1e-3)


@pytest.mark.parametrize(
    ("radius", "rod", "zero"), [(0.03, 0.03, 1), (0.02, 0.03, 0), (0.02, 0.03, math.pi),
                                (0.02, 0.03, -0.5)]
)  # fmt: skip
def test_crank_in_line_with_rod_at_zero_or_as_long_is_refused(radius, rod, zero):
    with pytest.raises(BadValueError, match="crank"):
        Crank(radius, rod, zero)


@pytest.mark.parametrize("sign", [-1, 1])
def test_slide_position_is_clamped_at_passed_dead_centre(sign):
    joint_map = JointMap.cranked("gripper", 5, sign, 2048.0, 4096, CRANK)
    end_m, half_turn = CRANK.position(CRANK.zero_rad), 2048
    assert joint_map.position_clamped(2048 + sign * half_turn) == pytest.approx(end_m)
    assert joint_map.position(2048 + sign * half_turn) < end_m
    assert joint_map.position_clamped(2148) == joint_map.position(2148)


def test_unit_per_tick_of_cranked_slide_is_its_largest_step():
    joint_map = JointMap.cranked("gripper", 5, 1, 2048.0, 4096, CRANK)
    horn_rad = math.tau / 4096
    assert joint_map.unit_per_tick == pytest.approx(CRANK.max_m_per_rad * horn_rad)
    assert joint_map.gear == 1.0

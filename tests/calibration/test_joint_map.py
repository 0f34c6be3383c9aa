"""Ticks and radians are exact inverses of each other."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ikservo.calibration import JointMap
from ikservo.errors import BadValueError

maps = st.builds(
    JointMap.revolute,
    joint=st.just("elbow"),
    servo_id=st.just(3),
    sign=st.sampled_from([-1, 1]),
    zero_tick=st.floats(0, 4095),
    ticks_per_turn=st.sampled_from([1024, 4096]),
)


@given(maps, st.integers(-9000, 9000))
def test_tick_to_radians_and_back_gives_same_tick(joint_map, tick):
    assert joint_map.tick(joint_map.position(tick)) == tick


def test_quarter_turn_of_12_bit_servo_is_1024_ticks():
    joint_map = JointMap.revolute("elbow", 3, 1, 2048, 4096)
    assert joint_map.position(3072) == pytest.approx(math.pi / 2)
    assert joint_map.tick(-math.pi / 2) == 1024


def test_mirrored_servo_ticks_decrease_as_joint_angle_increases():
    assert JointMap.revolute("elbow", 3, -1, 2048, 4096).tick(math.pi / 2) == 1024


def test_rack_moves_by_pitch_circumference_per_turn():
    rack = JointMap.prismatic("gripper", 15, 1, 2048, 4096, m_per_turn=0.08)
    assert rack.position(2048 + 1024) == pytest.approx(0.02)


@given(maps, st.floats(-3, 3), st.floats(0.01, 3))
def test_ticks_inside_tick_range_have_positions_inside_limits(joint_map, lower, width):
    low, high = joint_map.ticks_inside(lower, lower + width)
    ends = sorted((joint_map.position(low), joint_map.position(high)))
    assert lower - 1e-8 <= ends[0] <= ends[1] <= lower + width + 1e-8


def test_joint_range_without_a_whole_tick_is_refused():
    with pytest.raises(BadValueError, match="range of elbow"):
        JointMap.revolute("elbow", 3, 1, 2048, 4096).ticks_inside(0.0005, 0.0010)


@pytest.mark.parametrize("position", [math.nan, math.inf, -math.inf])
def test_non_finite_goal_is_refused(position):
    with pytest.raises(BadValueError, match="goal of elbow"):
        JointMap.revolute("elbow", 3, 1, 2048, 4096).tick(position)


@pytest.mark.parametrize(("exact", "nearest"), [(100.45, 100), (100.55, 101), (-0.45, 0)])
def test_joint_position_is_rounded_to_nearest_tick(exact, nearest):
    joint_map = JointMap.revolute("waist", 1, 1, 0.0, 4096)
    assert joint_map.tick(joint_map.position(exact)) == nearest


@pytest.mark.parametrize("off_by_rounding", [-5e-7, 0.0, 5e-7])
def test_joint_limit_exactly_on_a_tick_is_reachable(off_by_rounding):
    joint_map = JointMap.revolute("waist", 1, 1, 0.0, 4096)
    lower, upper = (joint_map.position(tick + off_by_rounding) for tick in (100, 200))
    assert joint_map.ticks_inside(lower, upper) == (100, 200)


def test_joint_without_gear_has_gear_ratio_1():
    assert JointMap("waist", 1, 1, 2048.0, math.tau / 4096).gear == 1.0


def test_joint_map_without_crank_does_not_clamp_positions():
    joint_map = JointMap.revolute("waist", 1, -1, 2048.0, 4096)
    assert (
        joint_map.position_clamped(1024) == joint_map.position(1024) == pytest.approx(math.pi / 2)
    )


def test_joint_position_text_is_in_degrees_or_millimetres():
    assert JointMap.revolute("waist", 1, 1, 0.0, 4096).format(math.radians(101.34)) == "101.3°"
    assert JointMap.prismatic("lift", 1, 1, 0.0, 4096, 0.04).format(0.01234) == "12.3 mm"


def test_rack_travel_is_given_per_radian_of_servo_horn():
    rack = JointMap.prismatic("gripper", 5, 1, 2048.0, 4096, m_per_turn=0.05)
    assert rack.horn_rad_per_tick == pytest.approx(math.tau / 4096)
    assert rack.unit_per_horn_rad == pytest.approx(0.05 / math.tau)

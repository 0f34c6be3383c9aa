"""Goals that one servo accepts, in its own ticks."""

import math
from dataclasses import replace

import pytest

from ikservo.calibration import Crank, JointMap, Limits
from ikservo.control.watchdog_and_torque_limits import unwatched_servos
from ikservo.errors import BadValueError
from ikservo.guard import DrivenJoint
from tests.guard.gates import TICK, make_limits

RACK = JointMap.prismatic("jaw", 6, -1, 2048, 4096, 0.05)


def test_allowed_tick_range_is_whole_ticks_inside_limits():
    joint_map = JointMap.revolute("elbow", 3, 1, 2048, 4096)
    limits = Limits.of("elbow", -1.5 * TICK, 2.5 * TICK, "user")
    assert DrivenJoint(joint_map, limits, 1.0).tick_range == (2047, 2050)


def test_allowed_position_range_ends_at_outermost_ticks():
    limits = Limits.of("jaw", 0.0, 0.0101, "user", "m")
    assert DrivenJoint(RACK, limits, 1.0).position_range == pytest.approx((0.0, 827 * 0.05 / 4096))


@pytest.mark.parametrize(("position", "tick"), [(0.4, 2048), (0.6, 2049), (2000.0, 4048)])
def test_position_outside_limits_is_still_rounded_to_a_tick(position, tick):
    assert make_limits().tick(position * TICK) == tick


@pytest.mark.parametrize(("position", "tick"), [(-1.5, 2047), (2.5, 2050)])
def test_tick_of_position_inside_limits_is_inside_limits(position, tick):
    joint_map = JointMap.revolute("elbow", 3, 1, 2048, 4096)
    limits = Limits.of("elbow", -1.5 * TICK, 2.5 * TICK, "user")
    assert DrivenJoint(joint_map, limits, 1.0).tick(position * TICK) == tick


def test_nan_goal_is_refused():
    with pytest.raises(BadValueError, match="goal of elbow"):
        make_limits().tick(math.nan)


def test_tick_rate_limit_includes_gear_ratio_of_joint():
    geared = JointMap.revolute("elbow", 3, 1, 2048, 4096, gear=2.0)
    limits = Limits.of("elbow", -1.0, 1.0, "user")
    assert DrivenJoint(geared, limits, 1.0).max_ticks_s == pytest.approx(2 * 4096 / math.tau)


@pytest.mark.parametrize(
    ("speed_deg_s", "lead"), [(25, 106), (52.7, 137), (52.8, 138), (60, 138), (120, 138)]
)
def test_maximum_lead_is_78_ticks_at_rest_plus_up_to_60(speed_deg_s, lead):
    assert make_limits().max_lead_ticks(math.radians(speed_deg_s)) == lead


@pytest.mark.parametrize(("short_ticks", "lead"), [(0.9e-6, 28), (1.1e-6, 27)])
def test_maximum_lead_tolerates_floating_point_rounding(short_ticks, lead):
    assert make_limits().max_lead_ticks((280.0 - 10.0 * short_ticks) * TICK) == 78 + lead


@pytest.mark.parametrize(("lag_rad", "lead"), [(0.1, 78), (0.15, 97), (0.2, 130), (0.3, 130)])
def test_maximum_lead_grows_with_lifting_lag_up_to_130_ticks(lag_rad, lead):
    limits = replace(make_limits(), lifting_lag_rad=lag_rad)
    assert limits.max_lead_ticks(0.0) == lead


@pytest.mark.parametrize(("sag_ticks", "far"), [(59.0, False), (61.0, True)])
def test_servo_of_joint_that_sags_by_60_ticks_has_no_watchdog(sag_ticks, far):
    driven = replace(make_limits(), sag_rad=sag_ticks * TICK)
    assert unwatched_servos([driven]) == ([driven.servo_id] if far else [])


def test_maximum_lead_scales_with_encoder_resolution():
    fine = JointMap.revolute("elbow", 3, 1, 0, 409_600)
    limits = Limits.of("elbow", -1.0, 1.0, "user")
    assert DrivenJoint(fine, limits, 5.0).max_lead_ticks(5.0) == 6000 + 7822


def test_maximum_lead_is_capped_by_top_speed_of_joint():
    assert make_limits(speed_tick_s=200).max_lead_ticks(10.0) == 98


def test_maximum_lead_is_measured_at_servo_horn():
    limits = Limits.of("elbow", -1.0, 1.0, "user")
    coarse = JointMap.revolute("elbow", 3, 1, 512, 1228.8)  # 1024 ticks on 300 degrees
    geared = JointMap.revolute("elbow", 3, 1, 2048, 4096, gear=2.0)
    cranked = JointMap.cranked("jaw", 6, 1, 2048, 4096, Crank(0.01, 0.03, math.radians(60)))
    slide = Limits.of("jaw", 0.0, 0.005, "user", "m")
    assert DrivenJoint(coarse, limits, 5.0).max_lead_ticks(5.0) == 18 + 23
    assert DrivenJoint(geared, limits, 5.0).max_lead_ticks(math.radians(10)) == 22 + 78
    assert DrivenJoint(cranked, slide, 1.0).max_lead_ticks(1.0) == 138


@pytest.mark.parametrize(
    ("tick", "words"),
    [
        (3001, "elbow target 83.8° is above its upper limit 83.7° (hand sweep)."),
        (999, "elbow target -92.2° is below its lower limit -92.1° (hand sweep)."),
    ],
)
def test_limit_violation_names_limit_in_effect(tick, words):
    assert make_limits().describe_violation(tick) == words


def test_violation_of_upper_limit_does_not_name_lower_limit():
    assert "below its lower limit -92.1°" in make_limits().describe_violation(3000)


def test_target_just_beyond_limit_is_shown_with_two_decimals():
    limits = Limits.of("lift", math.radians(-98.0), 1.5, "user")
    lift = DrivenJoint(JointMap.revolute("lift", 1, 1, 2048, 65536), limits, 1.0)
    assert lift.describe_violation(2048 - 17846) == (
        "lift target -98.03° is below its lower limit -98.00° (set by you)."
    )

"""Measurements of one joint from a calibration, in ticks and in rad."""

import math
from dataclasses import replace

import pytest

from ikservo.apps.calibrating.by_hand_procedure import CalibrationState
from ikservo.apps.calibrating.calibration_result import MeasuredJoint, measure_joint
from ikservo.calibration import JointMap, Limits
from ikservo.calibration.homing import TickRange
from ikservo.errors import CalibrationError
from tests.apps.calibrating.test_sweep import Hand, subject

TURN = 4096
EXPECTED = Limits.of("elbow", -1.0, 1.0, "arm file")


def measured(sign=1, low=1024, high=3072, swept="by hand"):
    return MeasuredJoint(
        JointMap.revolute("elbow", 1, sign, 2048, TURN), TickRange(low, high), swept
    )


def test_tick_shift_moves_zero_and_travel_equally():
    moved = measured().shift_ticks(100)
    assert (moved.joint_map.zero_tick, moved.travel) == (1948, TickRange(924, 2972))
    assert moved.range_inside_margin(0.0) == pytest.approx(measured().range_inside_margin(0.0))


@pytest.mark.parametrize("sign", [1, -1])
def test_joint_limits_are_swept_range_minus_margin(sign):
    quarter = math.pi / 2
    assert measured(sign).range_inside_margin(0.0) == pytest.approx((-quarter, quarter))
    assert measured(sign).range_inside_margin(0.1) == pytest.approx((-quarter + 0.1, quarter - 0.1))
    lopsided = measured(sign, low=2048).range_inside_margin(0.1)
    assert lopsided == pytest.approx((0.1, quarter - 0.1) if sign > 0 else (0.1 - quarter, -0.1))


def test_joint_that_was_not_swept_keeps_arm_file_limits():
    unswept = measured(swept="not swept")
    assert unswept.range_inside_margin(0.1) is None
    assert unswept.limits(EXPECTED, 0.1, None) == EXPECTED


def test_narrowest_of_sweep_arm_file_and_user_limit_applies():
    found = measured(low=1536).limits(EXPECTED, 0.0, Limits.of("elbow", -2.0, 0.5, "user"))
    assert (found.lower.value, found.lower.source) == (pytest.approx(-math.pi / 4), "hand sweep")
    assert (found.upper.value, found.upper.source) == (0.5, "user")
    found = measured().limits(EXPECTED, 0.0, None)
    assert (found.lower.value, found.upper.value) == (-1.0, 1.0)


def known(low, high, anchor):
    """Measure a joint with a known travel that is held in its pose at a tick."""
    hand = Hand(subject(known=TickRange(low, high)), start=anchor).rest().accept()
    return measure_joint(hand.state, hand.state.subjects[0])


@pytest.mark.parametrize(
    ("low", "high", "anchor", "travel"),
    [
        (1000, 3000, 1500, (1000, 3000)),
        (3500, 4500, 100, (-596, 404)),
        (6000, 9000, 708, (-2192, 808)),
        (1000, 3000, 999, (1000, 3000)),
        (1000, 3000, 3001, (1000, 3000)),
    ],
)
def test_known_travel_is_shifted_to_encoder_turn_of_anchor_pose(low, high, anchor, travel):
    found = known(low, high, anchor)
    assert (found.travel, found.swept) == (TickRange(*travel), "by LeRobot")


@pytest.mark.parametrize(
    ("low", "high", "anchor"),
    [(1000, 3000, 998), (1000, 3000, 3002), (6000, 9000, 810), (6000, 9000, 1902)],
)
def test_anchor_pose_outside_known_travel_is_refused(low, high, anchor):
    with pytest.raises(CalibrationError, match="elbow: its present position is outside"):
        known(low, high, anchor)


def test_known_travel_of_potentiometer_is_not_shifted():
    potentiometer = replace(subject(known=TickRange(20, 900)), ticks_per_turn=0)
    hand = Hand(potentiometer, start=100).rest().accept()
    assert measure_joint(hand.state, hand.state.subjects[0]).travel == TickRange(20, 900)


def test_travel_of_swept_joint_is_its_swept_range():
    hand = Hand(subject()).rest().accept().move(900).move(-1900)
    found = measure_joint(hand.state, hand.state.subjects[0])
    assert (found.travel, found.swept) == (TickRange(-900, 1000), "by hand")


@pytest.mark.parametrize("word", ["skip elbow", "continuous elbow"])
def test_skipped_or_continuous_joint_keeps_arm_file_travel(word):
    hand = Hand(subject()).rest().accept().move(900).say(word)
    found = measure_joint(hand.state, hand.state.subjects[0])
    assert found.swept == "not swept"
    assert found.travel.width == pytest.approx(3.0 / math.tau * TURN, abs=2)


def test_joint_moved_by_its_motor_is_marked_as_swept_by_motor():
    driven = replace(Hand(subject()).rest().accept().move(900).state, motor_driven=True)
    assert measure_joint(driven, driven.subjects[0]).swept == "by itself"


def test_motor_driven_joint_with_known_range_is_marked_as_driven():
    hand = Hand(subject(known=TickRange(1000, 3000)), start=1500).rest().accept()
    driven = replace(hand.state, motor_driven=True)
    assert measure_joint(driven, driven.subjects[0]).swept == "by itself"


def test_default_margin_inside_swept_range_is_2_degrees():
    state = CalibrationState((subject(),))
    (low, high) = measured().range_inside_margin(state.margin_rad)
    assert (math.degrees(low), math.degrees(high)) == pytest.approx((-88.0, 88.0))

"""The saved calibration and the registers to write: modes, offsets, limits, units."""

import math
from dataclasses import replace
from datetime import UTC, datetime

import pytest

from ikservo.apps.calibrating.calibration_result import CalibrationMetadata, build_calibration
from ikservo.calibration import JointMap, Limits
from ikservo.calibration.servo_config import ServoConfig
from ikservo.errors import CalibrationError
from ikservo.registers import MODELS, Family
from tests.apps.calibrating.test_sweep import TURN, Hand, subject
from tests.calibration.records import X

WHEN = datetime(2026, 11, 2, 14, 3, 22, tzinfo=UTC)
METADATA = CalibrationMetadata("wx250s", WHEN, "1", "", Family.DYNAMIXEL_2, "home")
LIMITS = {"min_position_limit": 500, "max_position_limit": 3500}


def swept(one=None, start=2048, shadow=None, down=1000, up=1000):
    """Sweep one joint from its start tick; its second servo starts at the tick ``shadow``."""
    hand = Hand(one or subject(shadow_ids=() if shadow is None else (2,)), start=start)
    if shadow is not None:
        hand.ticks[2] = shadow
    return hand.rest().accept().move(up).move(-up - down).move(down)


def build(hand, held=None, **more):
    """Build the calibration of Dynamixel servos with these registers, by id."""
    configs = {
        i: ServoConfig(i, MODELS["XM430-W350"], "", X | LIMITS | (held or {}).get(i, {}))
        for i in hand.ticks
    }
    return build_calibration(hand.state, configs, METADATA, **more)


def saved(hand, **more):
    (joint,) = build(hand, **more).calibration.joints
    return joint


def limits_in(registers):
    return registers["min_position_limit"], registers["max_position_limit"]


# --- one servo


def test_servo_limits_are_kept_unless_write_limits_is_set():
    assert limits_in(build(swept()).memory[1]) == (500, 3500)
    # 1.5 rad of the arm file are 977.8 ticks, less than the 1000 that were swept
    assert limits_in(build(swept(), write_limits=True).memory[1]) == (1071, 3025)


def test_multi_turn_servo_does_not_get_limits():
    across_the_seam = build(swept(start=100), write_limits=True)
    assert across_the_seam.memory[1]["operating_mode"] == 4
    assert limits_in(across_the_seam.memory[1]) == (500, 3500)
    assert across_the_seam.calibration.joints[0].extended


@pytest.mark.parametrize("mode", [3, 4])
def test_servo_keeps_operating_mode_if_travel_allows_it(mode):
    assert build(swept(), {1: {"operating_mode": mode}}).memory[1]["operating_mode"] == mode


@pytest.mark.parametrize("sign", [1, -1])
def test_source_of_joint_sign_found_by_hand_is_saved(sign):
    joint = JointMap.revolute("elbow", 1, sign, 2048, TURN)
    found = saved(swept(replace(subject(), joint_map=joint), up=1000 if sign > 0 else -1000))
    assert (found.sign, found.sign_from) == (sign, "by hand")


@pytest.mark.parametrize("sign", [1, -1])
def test_skipped_joint_has_arm_file_sign_and_no_range(sign):
    joint = JointMap.revolute("elbow", 1, sign, 2048, TURN)
    hand = Hand(replace(subject(), joint_map=joint), start=2048).rest().accept().say("skip elbow")
    found = saved(hand)
    assert (found.sign, found.sign_from, found.recorded_range()) == (sign, "arm file", None)


def test_range_of_revolute_joint_is_saved_in_degrees():
    found = saved(swept(), user={"elbow": Limits.of("elbow", -0.5, 0.25, "user")})
    swept_deg = 1000 * 360 / TURN
    assert (found.lower_deg, found.upper_deg) == pytest.approx((-swept_deg, swept_deg))
    assert (found.user_lower_deg, found.user_upper_deg) == pytest.approx(
        (math.degrees(-0.5), math.degrees(0.25))
    )
    assert (found.lower_m, found.upper_m, found.user_lower_m, found.user_upper_m) == (None,) * 4


def test_range_of_sliding_joint_is_saved_in_metres():
    slide = replace(
        subject(),
        joint_map=JointMap.prismatic("elbow", 1, 1, 2048, TURN, m_per_turn=0.08),
        expected=Limits.of("elbow", -0.02, 0.02, "arm file", "m"),
    )
    found = saved(swept(slide), user={"elbow": Limits.of("elbow", -0.01, 0.005, "user", "m")})
    swept_m = 1000 * 0.08 / TURN
    assert (found.lower_m, found.upper_m) == pytest.approx((-swept_m, swept_m))
    assert (found.user_lower_m, found.user_upper_m) == (-0.01, 0.005)
    assert (found.lower_deg, found.upper_deg) == (None, None)
    assert (found.user_lower_deg, found.user_upper_deg) == (None, None)


# --- two servos on one joint: a Dynamixel reports its sensor's tick plus its offset


@pytest.mark.parametrize("lead_offset", [0, 30, -30])
@pytest.mark.parametrize("apart", [57, -57])
def test_offset_makes_two_servos_of_joint_report_same_tick(lead_offset, apart):
    found = build(swept(shadow=2048 + apart), {1: {"homing_offset": lead_offset}})
    lead, shadow = (found.memory[i]["homing_offset"] for i in (1, 2))
    assert lead == lead_offset
    assert 2048 + lead == 2048 + apart + shadow
    assert [servo.id for servo in found.calibration.joints[0].servos] == [1, 2]


@pytest.mark.parametrize("present", [0, 57, -57])
@pytest.mark.parametrize(
    ("off", "corrected"), [(0, False), (3, False), (-3, False), (4, True), (-4, True)]
)
def test_second_servo_offset_that_is_3_ticks_off_is_kept(present, off, corrected):
    found = build(swept(shadow=2048 - present - off), {2: {"homing_offset": present}})
    assert found.memory[2]["homing_offset"] == (present + off if corrected else present)


def test_two_servos_of_joint_are_set_to_position_mode():
    found = build(swept(shadow=2060), {1: {"operating_mode": 4}, 2: {"operating_mode": 4}})
    assert [found.memory[i]["operating_mode"] for i in (1, 2)] == [3, 3]


def test_travel_across_wrap_around_is_refused_for_two_servos():
    with pytest.raises(CalibrationError, match="two servos on one joint cannot both use multi-"):
        build(swept(start=100, shadow=100))


@pytest.mark.parametrize("apart", [1024, -1024])
def test_two_servos_of_joint_may_be_1024_ticks_apart(apart):
    assert build(swept(shadow=2048 - apart)).memory[2]["homing_offset"] == apart


@pytest.mark.parametrize("apart", [1025, -1025])
def test_servos_of_joint_over_1024_ticks_apart_are_refused(apart):
    with pytest.raises(
        CalibrationError, match=f"Servo 2 of elbow is {apart} ticks away from servo 1;"
    ):
        build(swept(shadow=2048 - apart))


@pytest.mark.parametrize(("down", "up", "apart"), [(1500, 100, 548), (100, 1500, -547)])
def test_second_servo_travel_may_reach_wrap_around(down, up, apart):
    # it goes from its tick 0, or to its tick 4095
    found = build(swept(shadow=2048 - apart, down=down, up=up))
    assert found.memory[2]["homing_offset"] == apart


@pytest.mark.parametrize(("down", "up", "apart"), [(1500, 100, 549), (100, 1500, -548)])
def test_second_servo_travel_across_wrap_around_is_refused(down, up, apart):
    with pytest.raises(
        CalibrationError, match=f"Servo 2 of elbow is {apart} ticks away from servo 1;"
    ):
        build(swept(shadow=2048 - apart, down=down, up=up))

"""The start of a servo's count, tick for tick."""

import pytest

from ikservo.calibration.homing import Homing, TickRange, choose_homing, encoder_tick
from ikservo.calibration.joint_map import Encoder
from ikservo.errors import CalibrationError
from ikservo.registers import Family

MAGNET, POTENTIOMETER = Encoder(4096, 4096.0), Encoder(1024, 1228.8)
STS, X = Family.FEETECH_STS, Family.DYNAMIXEL_2


def homing_of(family, low, high, offset=0, encoder=MAGNET, **more):
    return choose_homing("elbow", family, TickRange(low, high), offset, encoder, **more)


@pytest.mark.parametrize(("family", "bare"), [(STS, 100), (X, 4000), (Family.DYNAMIXEL_1, 4000)])
def test_encoder_tick_uses_offset_sign_of_servo_family(family, bare):
    assert encoder_tick(family, 2050, 2146 if family is STS else -1950, MAGNET) == bare


def test_potentiometer_tick_beyond_its_end_is_not_wrapped():
    assert encoder_tick(Family.FEETECH_SCS, 1030, 0, POTENTIOMETER) == 1030


@pytest.mark.parametrize(
    ("low", "high", "kept"),
    [
        (64, 3000, True),  # far enough from the wrap-around
        (63, 3000, False),
        (1000, 4031, True),
        (1000, 4032, False),
        (19, 4075, True),  # no room to be further away
        (20, 4076, True),
        (18, 4074, False),
        (21, 4077, False),
    ],
)
def test_sts_offset_is_kept_if_travel_avoids_wrap_around(low, high, kept):
    found = homing_of(STS, low, high)
    assert (found.offset == 0) is kept


@pytest.mark.parametrize("turns", [-2, 1])
def test_sts_offset_is_kept_if_travel_lies_in_another_turn(turns):
    low, high = 500 + 4096 * turns, 3000 + 4096 * turns
    assert homing_of(STS, low, high, offset=300) == Homing(300, False, low - 200)


def test_sts_travel_across_wrap_around_is_centred_by_homing():
    # 1000 ticks leave 1547 on either side
    assert homing_of(STS, 3596, 4596) == Homing(-2047, False, 3596 - 1547)
    assert homing_of(STS, -500, 500) == Homing(-2047, False, -500 - 1547)
    # the offset would be 2048, which does not fit
    assert homing_of(STS, 3595, 4595) == Homing(2047, False, 3595 - 1548)
    assert homing_of(STS, 96, 4095) == Homing(48, False, 48)


def test_sts_offset_that_its_register_cannot_hold_is_not_kept():
    assert homing_of(STS, 500, 3000, offset=2048).offset != 2048
    assert homing_of(STS, 3000, 5000, offset=-2048).offset != -2048
    assert homing_of(STS, 2600, 5600, offset=2047).offset == 2047


@pytest.mark.parametrize(
    ("low", "high", "offset", "kept"),
    [
        (1000, 3000, -1000, True),
        (1000, 3000, -1001, False),
        (1000, 3071, 1024, True),
        (1000, 3072, 1024, False),
        (1000, 2000, 1025, False),
        (1100, 2000, -1025, False),
    ],
)
def test_x_series_offset_within_one_turn_is_kept(low, high, offset, kept):
    found = homing_of(X, low, high, offset)
    assert found == (Homing(offset, False, -offset) if kept else Homing(0, False, 0))


def test_x_series_is_multi_turn_only_if_travel_wraps_around():
    assert homing_of(X, 96, 4095) == Homing(0, False, 0)
    assert homing_of(X, 4096, 4096 + 2000) == Homing(0, False, 4096)
    found = homing_of(X, 3000, 4096, offset=5)
    assert found == Homing(5, True, 3548 - 3553)


def test_x_series_stays_multi_turn_if_travel_wraps_around():
    assert homing_of(X, 5096, 6096, offset=100, counts_on=True) == Homing(100, True, 5596 - 1600)


@pytest.mark.parametrize("encoder", [MAGNET, POTENTIOMETER])
def test_homing_refuses_travel_of_sensor_size_or_more(encoder):
    homing_of(Family.DYNAMIXEL_1, 0, encoder.ticks - 2, encoder=encoder)
    with pytest.raises(CalibrationError, match="more than one turn"):
        homing_of(Family.DYNAMIXEL_1, 0, encoder.ticks - 1, encoder=encoder)


@pytest.mark.parametrize("family", Family)
@pytest.mark.parametrize(("low", "high"), [(0, 500), (523, 1023)])
def test_potentiometer_servo_may_use_its_whole_sensor_range(family, low, high):
    found = homing_of(family, low, high, encoder=POTENTIOMETER)
    assert found == Homing(0, False, 0)


@pytest.mark.parametrize("family", Family)
@pytest.mark.parametrize(("low", "high"), [(-1, 500), (-500, -400), (524, 1024)])
def test_potentiometer_servo_refuses_travel_off_its_sensor(family, low, high):
    with pytest.raises(CalibrationError, match="wrap-around"):
        homing_of(family, low, high, encoder=POTENTIOMETER)


def test_travel_is_shifted_by_whole_turns_without_offset():
    found = homing_of(Family.DYNAMIXEL_1, -4000, -3000)
    assert found == Homing(0, False, -4096)

"""The count of ticks wraps around, and no caller notices it."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from ikservo.calibration.homing import TickRange, choose_homing, encoder_tick
from ikservo.calibration.joint_map import (
    Encoder,
    encoder_of,
    unwrap,
    unwrap_near,
    wrapped_difference,
)
from ikservo.errors import CalibrationError
from ikservo.registers import MODELS, Family

TURN = 4096
MAGNET, POTENTIOMETER = Encoder(4096, 4096.0), Encoder(1024, 1024 * 1.2)
STS, X = Family.FEETECH_STS, Family.DYNAMIXEL_2
travels = st.builds(
    lambda low, width: TickRange(low, low + width), st.integers(-9000, 9000), st.integers(50, 4094)
)


def test_unwrap_finds_true_tick_for_any_offset_and_direction():
    """Hazard M6, exhaustive: 4096 positions × offsets −2047..2047 step 13 × direction."""
    bare = np.arange(TURN)
    cases = wrong = 0
    for offset in range(-2047, 2048, 13):
        present = (bare - offset) % TURN
        wrong += np.count_nonzero(encoder_tick(STS, present, offset, MAGNET) != bare)
        for direction in (-1, 1):
            reading = (bare + direction * 37 - offset) % TURN
            counted = unwrap(present, reading, TURN)
            wrong += np.count_nonzero(counted - present != direction * 37)
            cases += bare.size
    assert cases == 2_580_480
    assert wrong == 0


@given(st.integers(-99999, 99999), st.integers(-99999, 99999))
def test_wrapped_tick_difference_is_at_most_half_a_turn(start, end):
    way = wrapped_difference(start, end, TURN)
    assert (start + way - end) % TURN == 0
    assert -TURN // 2 <= way < TURN // 2


@given(st.integers(-9999, 9999), st.lists(st.integers(-1024, 1024), max_size=60))
def test_unwrap_follows_joint_across_every_wrap_around(start, steps):
    truth = last = start
    for step in steps:
        truth += step
        last = unwrap(last, truth % TURN, TURN)
    assert last == truth


@given(travels, st.integers(-2047, 2047))
def test_sts_homing_fits_register_and_avoids_wrap_around(travel, offset):
    homing = choose_homing("elbow", STS, travel, offset, MAGNET)
    assert abs(homing.offset) <= 2047
    for tick in (travel.low, travel.high):
        reported = (tick - homing.offset) % TURN
        assert reported == tick - homing.shift
    assert 0 <= travel.low - homing.shift < travel.high - homing.shift <= TURN - 1


@given(travels, st.integers(-5000, 5000))
def test_x_series_homing_keeps_one_turn_without_wrap_around(travel, offset):
    homing = choose_homing("elbow", X, travel, offset, MAGNET)
    crosses = travel.low // TURN != travel.high // TURN
    assert homing.extended == crosses
    if not crosses:
        assert abs(homing.offset) <= 1024
        assert travel.low % TURN + homing.offset == travel.low - homing.shift
        assert 0 <= travel.low - homing.shift < travel.high - homing.shift <= TURN - 1


def test_homing_keeps_offset_that_already_avoids_wrap_around():
    assert choose_homing("elbow", STS, TickRange(900, 2500), 400, MAGNET).offset == 400
    assert choose_homing("elbow", X, TickRange(900, 2500), -30, MAGNET).offset == -30


@pytest.mark.parametrize("width", [50, 3000, 3001, 4093, 4094])
def test_sts_homing_never_needs_an_offset_of_2048(width):
    # -2048 and 2048 are the same place, and neither fits: LeRobot's "Magnitude 2114".
    for low in range(4096):
        homing = choose_homing("elbow", STS, TickRange(low, low + width), 2048, MAGNET)
        assert abs(homing.offset) <= 2047
        assert low - homing.shift >= 0
        assert low + width - homing.shift <= TURN - 1


@given(st.integers(0, 4095), st.integers(-2047, 2047))
def test_homing_finds_offset_for_travel_of_4094_ticks(low, offset):
    travel = TickRange(low, low + 4094)
    homing = choose_homing("elbow", STS, travel, offset, MAGNET)
    assert abs(homing.offset) <= 2047
    assert 0 <= travel.low - homing.shift < travel.high - homing.shift <= TURN - 1


@pytest.mark.parametrize("family", [STS, X])
def test_homing_offset_search_refuses_travel_of_a_whole_turn(family):
    with pytest.raises(CalibrationError, match=r"travel of 4095 ticks.*\n.*--continuous elbow"):
        choose_homing("elbow", family, TickRange(0, 4095), 0, MAGNET)


def test_homing_without_offset_refuses_travel_across_wrap_around():
    with pytest.raises(CalibrationError, match="horn a few teeth further"):
        choose_homing("elbow", Family.DYNAMIXEL_1, TickRange(4000, 5000), 0, MAGNET)


def test_potentiometer_has_no_wrap_around():
    homing = choose_homing("elbow", Family.FEETECH_SCS, TickRange(20, 1003), 0, POTENTIOMETER)
    assert (homing.offset, homing.extended, homing.shift) == (0, False, 0)
    assert encoder_tick(Family.FEETECH_SCS, 700, 0, POTENTIOMETER) == 700


@given(st.integers(-9999, 9999), st.integers(0, 4095))
def test_unwrapped_tick_is_within_half_a_turn_of_given_middle(middle, reading):
    tick = unwrap_near(middle, reading, TURN)
    assert (tick - reading) % TURN == 0
    assert abs(tick - middle) <= TURN // 2


@pytest.mark.parametrize(("model", "ticks", "per_turn"), [
    ("STS3215", 4096, 4096), ("XM430-W350", 4096, 4096), ("MX-28", 4096, 4096),
    ("AX-12A", 1024, 1228.8), ("SCS0009", 1024, 1228.8),
])  # fmt: skip
def test_encoder_of_each_model_matches_its_data_sheet(model, ticks, per_turn):
    encoder = encoder_of(MODELS[model])
    assert (encoder.ticks, encoder.ticks_per_turn) == (ticks, pytest.approx(per_turn))
    assert encoder.wraps == (ticks == 4096)


def test_wrapped_tick_difference_is_symmetric_for_odd_counts():
    assert [wrapped_difference(0, end, 5) for end in range(5)] == [0, 1, 2, -2, -1]

"""The count of ticks begins again somewhere; nobody above may notice."""

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


def test_every_position_offset_and_direction_unwraps_and_comes_back():
    """Hazard M6, all of it: 4096 positions × offsets −2047..2047 step 13 × direction."""
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
def test_the_short_way_leads_there_and_is_at_most_half_a_turn(start, end):
    way = wrapped_difference(start, end, TURN)
    assert (start + way - end) % TURN == 0
    assert -TURN // 2 <= way < TURN // 2


@given(st.integers(-9999, 9999), st.lists(st.integers(-1024, 1024), max_size=60))
def test_a_hand_that_turns_on_and_on_is_followed_over_every_seam(start, steps):
    truth = last = start
    for step in steps:
        truth += step
        last = unwrap(last, truth % TURN, TURN)
    assert last == truth


@given(travels, st.integers(-2047, 2047))
def test_an_sts_offset_fits_its_register_and_keeps_the_seam_out_of_the_travel(travel, offset):
    homing = choose_homing("elbow", STS, travel, offset, MAGNET)
    assert abs(homing.offset) <= 2047
    for tick in (travel.low, travel.high):
        reported = (tick - homing.offset) % TURN
        assert reported == tick - homing.shift
    assert 0 <= travel.low - homing.shift < travel.high - homing.shift <= TURN - 1


@given(travels, st.integers(-5000, 5000))
def test_an_x_servo_in_position_mode_keeps_to_one_turn_and_its_offset_in_force(travel, offset):
    homing = choose_homing("elbow", X, travel, offset, MAGNET)
    crosses = travel.low // TURN != travel.high // TURN
    assert homing.extended == crosses
    if not crosses:
        assert abs(homing.offset) <= 1024
        assert travel.low % TURN + homing.offset == travel.low - homing.shift
        assert 0 <= travel.low - homing.shift < travel.high - homing.shift <= TURN - 1


def test_an_offset_that_serves_is_kept_so_that_nothing_has_to_be_written():
    assert choose_homing("elbow", STS, TickRange(900, 2500), 400, MAGNET).offset == 400
    assert choose_homing("elbow", X, TickRange(900, 2500), -30, MAGNET).offset == -30


@pytest.mark.parametrize("width", [50, 3000, 3001, 4093, 4094])
def test_no_travel_asks_for_the_offset_that_sign_and_11_bits_cannot_hold(width):
    # -2048 and 2048 are the same place, and neither fits: LeRobot's "Magnitude 2114".
    for low in range(4096):
        homing = choose_homing("elbow", STS, TickRange(low, low + width), 2048, MAGNET)
        assert abs(homing.offset) <= 2047
        assert low - homing.shift >= 0
        assert low + width - homing.shift <= TURN - 1


@given(st.integers(0, 4095), st.integers(-2047, 2047))
def test_a_travel_of_almost_a_turn_finds_its_one_offset_wherever_the_horn_is(low, offset):
    travel = TickRange(low, low + 4094)
    homing = choose_homing("elbow", STS, travel, offset, MAGNET)
    assert abs(homing.offset) <= 2047
    assert 0 <= travel.low - homing.shift < travel.high - homing.shift <= TURN - 1


@pytest.mark.parametrize("family", [STS, X])
def test_a_travel_of_a_turn_is_refused(family):
    with pytest.raises(CalibrationError, match=r"travel of 4095 ticks.*\n.*--continuous elbow"):
        choose_homing("elbow", family, TickRange(0, 4095), 0, MAGNET)


def test_a_servo_without_an_offset_refuses_a_travel_across_its_seam():
    with pytest.raises(CalibrationError, match="horn a few teeth further"):
        choose_homing("elbow", Family.DYNAMIXEL_1, TickRange(4000, 5000), 0, MAGNET)


def test_a_potentiometer_has_no_seam():
    homing = choose_homing("elbow", Family.FEETECH_SCS, TickRange(20, 1003), 0, POTENTIOMETER)
    assert (homing.offset, homing.extended, homing.shift) == (0, False, 0)
    assert encoder_tick(Family.FEETECH_SCS, 700, 0, POTENTIOMETER) == 700


@given(st.integers(-9999, 9999), st.integers(0, 4095))
def test_a_reading_is_moved_to_within_half_a_turn_of_where_the_joint_lives(middle, reading):
    tick = unwrap_near(middle, reading, TURN)
    assert (tick - reading) % TURN == 0
    assert abs(tick - middle) <= TURN // 2


@pytest.mark.parametrize(("model", "ticks", "per_turn"), [
    ("STS3215", 4096, 4096), ("XM430-W350", 4096, 4096), ("MX-28", 4096, 4096),
    ("AX-12A", 1024, 1228.8), ("SCS0009", 1024, 1228.8),
])  # fmt: skip
def test_each_model_counts_as_its_sheet_says(model, ticks, per_turn):
    encoder = encoder_of(MODELS[model])
    assert (encoder.ticks, encoder.ticks_per_turn) == (ticks, pytest.approx(per_turn))
    assert encoder.wraps == (ticks == 4096)


def test_the_short_way_around_a_circle_of_an_odd_number_goes_either_way_as_far():
    assert [wrapped_difference(0, end, 5) for end in range(5)] == [0, 1, 2, -2, -1]

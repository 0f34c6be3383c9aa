"""What a servo's memory should hold for a calibration, register by register."""

import pytest

from ikservo.calibration.servo_config import (
    ServoConfig,
    calibration_registers,
    expected_registers,
    is_multi_turn,
    registers_differ,
    same_direction,
)
from ikservo.registers import MODELS
from tests.calibration.records import SCS, STS, X


def facts(model="STS3215", **held):
    known = {"STS3215": STS, "XM430-W350": X, "SCS15": SCS}[model]
    return ServoConfig(1, MODELS[model], "", known | held)


def wanted_of(found, offset=0, limits=None, extended=False):
    return expected_registers(found, offset, limits, extended=extended)


@pytest.mark.parametrize(
    ("mode", "offset", "in_force"),
    [(3, 1024, 1024), (3, 1025, 0), (3, -1024, -1024), (3, -1025, 0), (4, 5000, 5000)],
)
def test_a_dynamixel_in_position_mode_ignores_a_large_offset(mode, offset, in_force):
    found = facts("XM430-W350", operating_mode=mode, homing_offset=offset)
    assert found.offset == in_force


def test_an_sts_obeys_any_offset_and_a_servo_without_one_has_none():
    assert facts(operating_mode=3, homing_offset=2000).offset == 2000
    assert facts("SCS15").offset == 0


@pytest.mark.parametrize(
    ("mode", "on"), [(3, False), (4, True), (5, True), (0, False), (16, False)]
)
def test_two_modes_of_a_dynamixel_count_on_over_a_turn(mode, on):
    assert facts("XM430-W350", operating_mode=mode).is_multi_turn is on
    assert is_multi_turn(X | {"operating_mode": mode}) is on


def test_an_sts_never_counts_on():
    assert not facts(operating_mode=4).is_multi_turn
    assert not is_multi_turn(SCS)


@pytest.mark.parametrize(
    ("model", "held", "alike"),
    [
        ("STS3215", {}, True),
        ("STS3215", {"operating_mode": 1}, False),
        ("STS3215", {"phase": 12 | 0b1000_0000}, False),
        ("STS3215", {"phase": 12 | 0b0001_0000}, False),
        ("STS3215", {"phase": 12 | 0b0000_0001}, False),
        ("STS3215", {"phase": 0}, True),
        ("XM430-W350", {"operating_mode": 3}, True),
        ("XM430-W350", {"operating_mode": 4}, True),
        ("XM430-W350", {"operating_mode": 5}, True),
        ("XM430-W350", {"operating_mode": 1}, False),
        ("XM430-W350", {"drive_mode": 1}, False),
        ("XM430-W350", {"drive_mode": 4}, True),
        ("XM430-W350", {"homing_offset": 1025}, False),
        ("SCS15", {"min_position_limit": 5}, True),
    ],
)
def test_servos_count_alike_in_one_direction_with_offsets_in_force(model, held, alike):
    filed = {"STS3215": STS, "XM430-W350": X, "SCS15": SCS}[model]
    assert same_direction(facts(model, **held), filed) is alike


def test_a_direction_that_the_file_does_not_tell_is_not_compared():
    filed = {name: number for name, number in STS.items() if name != "phase"}
    assert same_direction(facts(phase=255), filed)


@pytest.mark.parametrize(
    ("register", "one", "other", "differs"),
    [("phase", 0, 0b0110_1110, False), ("phase", 0, 0b1000_0000, True), ("phase", 1, 0, True),
     ("drive_mode", 4, 8, False), ("drive_mode", 4, 5, True), ("homing_offset", 0, 1, True),
     ("homing_offset", 0, 2, True), ("homing_offset", -3, -3, False)],
)  # fmt: skip
def test_only_bits_that_turn_the_count_make_a_difference(register, one, other, differs):
    assert registers_differ(register, one, other) is differs


@pytest.mark.parametrize("model", ["STS3215", "XM430-W350", "SCS15"])
def test_a_calibration_rests_on_the_registers_that_a_file_holds(model):
    names = {register.name for register in calibration_registers(MODELS[model])}
    assert names == facts(model).registers.keys()


def test_what_is_right_stays_as_it_is():
    assert wanted_of(facts()) == STS
    assert wanted_of(facts("XM430-W350")) == X
    assert wanted_of(facts("SCS15")) == SCS


def test_an_sts_is_put_into_position_mode_and_counts_one_turn():
    wanted = wanted_of(facts(operating_mode=3, phase=0b0001_1101))
    assert (wanted["operating_mode"], wanted["phase"]) == (0, 0b0000_1101)


@pytest.mark.parametrize(
    ("mode", "extended", "wanted"), [(3, False, 3), (3, True, 4), (4, False, 3), (1, True, 4),
                                     (5, False, 5), (5, True, 5)]
)  # fmt: skip
def test_a_dynamixel_counts_on_where_it_must_and_a_gripper_stays_soft(mode, extended, wanted):
    found = facts("XM430-W350", operating_mode=mode)
    assert wanted_of(found, extended=extended)["operating_mode"] == wanted


@pytest.mark.parametrize("model", ["STS3215", "XM430-W350"])
def test_limits_that_would_mean_other_places_are_opened(model):
    found = facts(model, min_position_limit=500, max_position_limit=3000)
    assert wanted_of(found)["min_position_limit"] == 500
    moved = wanted_of(found, 9)
    assert moved["homing_offset"] == 9
    assert (moved["min_position_limit"], moved["max_position_limit"]) == (0, 4095)


@pytest.mark.parametrize(("low", "high"), [(0, 3000), (500, 0)])
def test_one_limit_of_zero_is_a_limit(low, high):
    wanted = wanted_of(facts(min_position_limit=low, max_position_limit=high))
    assert (wanted["min_position_limit"], wanted["max_position_limit"]) == (low, high)


def test_limits_of_zero_mean_none_and_are_opened():
    unset = wanted_of(facts(min_position_limit=0, max_position_limit=0))
    assert (unset["min_position_limit"], unset["max_position_limit"]) == (0, 4095)


@pytest.mark.parametrize(
    ("limits", "written"),
    [((100, 3900), (100, 3900)), ((-5, 5000), (0, 4095)), ((4095, 4096), (4094, 4095))],
)
def test_limits_are_written_as_far_as_their_registers_go(limits, written):
    wanted = wanted_of(facts(), limits=limits)
    assert (wanted["min_position_limit"], wanted["max_position_limit"]) == written

"""The register values that a calibration requires in a servo."""

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
def test_dynamixel_in_position_mode_ignores_offset_above_1024(mode, offset, in_force):
    found = facts("XM430-W350", operating_mode=mode, homing_offset=offset)
    assert found.offset == in_force


def test_sts_servo_applies_homing_offset_and_scs_has_none():
    assert facts(operating_mode=3, homing_offset=2000).offset == 2000
    assert facts("SCS15").offset == 0


@pytest.mark.parametrize(
    ("mode", "on"), [(3, False), (4, True), (5, True), (0, False), (16, False)]
)
def test_dynamixel_modes_4_and_5_are_multi_turn(mode, on):
    assert facts("XM430-W350", operating_mode=mode).is_multi_turn is on
    assert is_multi_turn(X | {"operating_mode": mode}) is on


def test_feetech_servos_are_never_multi_turn():
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
def test_count_direction_depends_on_mode_and_direction_bits(model, held, alike):
    filed = {"STS3215": STS, "XM430-W350": X, "SCS15": SCS}[model]
    assert same_direction(facts(model, **held), filed) is alike


def test_count_direction_missing_in_file_is_not_compared():
    filed = {name: number for name, number in STS.items() if name != "phase"}
    assert same_direction(facts(phase=255), filed)


@pytest.mark.parametrize(
    ("register", "one", "other", "differs"),
    [("phase", 0, 0b0110_1110, False), ("phase", 0, 0b1000_0000, True), ("phase", 1, 0, True),
     ("drive_mode", 4, 8, False), ("drive_mode", 4, 5, True), ("homing_offset", 0, 1, True),
     ("homing_offset", 0, 2, True), ("homing_offset", -3, -3, False)],
)  # fmt: skip
def test_drive_mode_difference_ignores_unrelated_bits(register, one, other, differs):
    assert registers_differ(register, one, other) is differs


@pytest.mark.parametrize("model", ["STS3215", "XM430-W350", "SCS15"])
def test_calibration_registers_equal_those_written_to_file(model):
    names = {register.name for register in calibration_registers(MODELS[model])}
    assert names == facts(model).registers.keys()


def test_calibration_registers_match_expected_table_per_series():
    assert wanted_of(facts()) == STS
    assert wanted_of(facts("XM430-W350")) == X
    assert wanted_of(facts("SCS15")) == SCS


def test_sts_servo_is_set_to_single_turn_position_mode():
    wanted = wanted_of(facts(operating_mode=3, phase=0b0001_1101))
    assert (wanted["operating_mode"], wanted["phase"]) == (0, 0b0000_1101)


@pytest.mark.parametrize(
    ("mode", "extended", "wanted"), [(3, False, 3), (3, True, 4), (4, False, 3), (1, True, 4),
                                     (5, False, 5), (5, True, 5)]
)  # fmt: skip
def test_dynamixel_is_set_multi_turn_only_if_travel_needs_it(mode, extended, wanted):
    found = facts("XM430-W350", operating_mode=mode)
    assert wanted_of(found, extended=extended)["operating_mode"] == wanted


@pytest.mark.parametrize("model", ["STS3215", "XM430-W350"])
def test_servo_limits_are_widened_if_homing_offset_changes(model):
    found = facts(model, min_position_limit=500, max_position_limit=3000)
    assert wanted_of(found)["min_position_limit"] == 500
    moved = wanted_of(found, 9)
    assert moved["homing_offset"] == 9
    assert (moved["min_position_limit"], moved["max_position_limit"]) == (0, 4095)


@pytest.mark.parametrize(("low", "high"), [(0, 3000), (500, 0)])
def test_single_servo_position_limit_of_zero_is_kept(low, high):
    wanted = wanted_of(facts(min_position_limit=low, max_position_limit=high))
    assert (wanted["min_position_limit"], wanted["max_position_limit"]) == (low, high)


def test_servo_position_limits_that_are_both_zero_are_widened():
    unset = wanted_of(facts(min_position_limit=0, max_position_limit=0))
    assert (unset["min_position_limit"], unset["max_position_limit"]) == (0, 4095)


@pytest.mark.parametrize(
    ("limits", "written"),
    [((100, 3900), (100, 3900)), ((-5, 5000), (0, 4095)), ((4095, 4096), (4094, 4095))],
)
def test_servo_position_limits_are_clipped_to_register_range(limits, written):
    wanted = wanted_of(facts(), limits=limits)
    assert (wanted["min_position_limit"], wanted["max_position_limit"]) == written

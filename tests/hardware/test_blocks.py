"""Several registers in one reply."""

from __future__ import annotations

import pytest

from ikservo.hardware import ServoBus, ServoSpec
from ikservo.hardware.register_batches import contiguous_runs
from ikservo.registers import STS3215, XL430W250, RegisterName

from .packets import sync_request

TELEMETRY = [
    RegisterName.PRESENT_POSITION,
    RegisterName.PRESENT_VELOCITY,
    RegisterName.PRESENT_LOAD,
    RegisterName.PRESENT_VOLTAGE,
    RegisterName.PRESENT_TEMPERATURE,
]


def test_adjacent_registers_are_read_together():
    wanted = [STS3215.present_load, STS3215.present_position, STS3215.present_speed]
    assert contiguous_runs(wanted) == [
        [STS3215.present_position, STS3215.present_speed, STS3215.present_load]
    ]


def test_register_gap_splits_read_into_two():
    wanted = [STS3215.present_position, STS3215.goal_position]
    assert contiguous_runs(wanted) == [[STS3215.goal_position], [STS3215.present_position]]


def test_register_requested_twice_is_read_once():
    assert contiguous_runs([STS3215.moving, STS3215.moving]) == [[STS3215.moving]]


def test_feetech_telemetry_is_read_in_one_request(feetech, line):
    line.expect("FF FF FE 05 82 38 08 01 39", "FF FF 01 0A 00 00 08 32 80 F4 01 7B 23 A7")
    readings = feetech.sync_read_many([1], TELEMETRY, raw=True).require_all()[1]
    assert [readings[role] for role in TELEMETRY] == [2048, -50, 500, 123, 35]


def test_sync_read_many_returns_values_in_units(feetech, line):
    line.expect("FF FF FE 05 82 3E 02 01 39", "FF FF 01 04 00 7B 23 5C")
    wanted = [STS3215.present_voltage, STS3215.present_temperature]
    readings = feetech.sync_read_many([1], wanted).require_all()[1]
    assert [readings[register] for register in wanted] == pytest.approx([12.3, 35.0])


def test_servo_silent_in_one_of_two_reads_has_error_and_no_value(feetech, line):
    line.expect("FF FF FE 05 82 2A 02 01 4D", "FF FF 01 04 00 00 08 F2")
    line.expect(sync_request([1], 55, 3))
    wanted = [STS3215.present_position, STS3215.goal_position]
    readings = feetech.sync_read_many([1], wanted)
    assert readings.values == {}
    assert "read present_position" in str(readings.errors[1])


def test_servo_families_are_read_together_despite_register_order(port, line):
    bus = ServoBus(port, [ServoSpec(1, STS3215), ServoSpec(2, XL430W250)])
    line.expect("FF FF FE 05 82 3E 02 01 39", "FF FF 01 04 00 7B 23 5C")
    line.expect(
        "FF FF FD 00 FE 08 00 82 90 00 03 00 02 FB 49",
        "FF FF FD 00 02 07 00 55 00 7B 00 23 56 F3",
    )
    readings = bus.sync_read_many(
        [1, 2], [RegisterName.PRESENT_VOLTAGE, RegisterName.PRESENT_TEMPERATURE]
    )
    assert [row[RegisterName.PRESENT_TEMPERATURE] for row in readings.require_all().values()] == [
        35.0,
        35.0,
    ]

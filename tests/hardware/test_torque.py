"""Torque comes on without a jump and goes off whatever happens."""

from __future__ import annotations

import pytest

from ikservo.errors import ServoAlarmError, ServoRejectedError, ServoSilentError
from ikservo.hardware import check_supply_voltage, torque_off, torque_on

from .packets import reply, request, sync_request

VOLTAGE, VOLTAGE_12 = "FF FF 01 04 02 3E 01 B9", "FF FF 01 03 00 78 83"
# Each question within 20 ms has an answer of another length than the three before it.
LOWEST, LOWEST_4 = request(1, 14, 2), reply(1, 140, 40)
HIGHEST, HIGHEST_14 = request(1, 12, 3), reply(1, 0, 70, 140)
POSITION, AT_2048 = request(1, 55, 3), reply(1, 1, 0, 8)
LIMITS, LIMITS_4095 = sync_request([1], 9, 4), reply(1, 0, 0, 255, 15)
TORQUE, IS_OFF = request(1, 39, 2), reply(1, 0, 0)
MODE, MODE_0 = sync_request([1], 33, 1), reply(1, 0)
GOAL, GOAL_2048, GOAL_5 = request(1, 40, 4), reply(1, 0, 0, 0, 8), reply(1, 0, 0, 5, 0)
SET_GOAL_2048 = "FF FF 01 05 03 2A 00 08 C4"
ON, OFF, TAKEN = "FF FF 01 04 03 28 01 CE", "FF FF 01 04 03 28 00 CF", "FF FF 01 02 00 FC"


@pytest.fixture
def fed(line):
    """Answer the three requests for the supply voltage."""
    return line.expect(VOLTAGE, VOLTAGE_12).expect(LOWEST, LOWEST_4).expect(HIGHEST, HIGHEST_14)


@pytest.fixture
def ranged(fed):
    """Answer the requests for the accepted goals and for torque as well."""
    return fed.expect(LIMITS, LIMITS_4095).expect(MODE, MODE_0).expect(TORQUE, IS_OFF)


def test_torque_on_writes_position_as_goal_first(feetech, ranged):
    ranged.expect(POSITION, AT_2048).expect(SET_GOAL_2048, TAKEN).expect(GOAL, GOAL_2048)
    ranged.expect(ON, TAKEN)
    assert torque_on(feetech, 1) == 2048


def test_torque_goes_off_if_servo_does_not_accept_goal(feetech, ranged):
    ranged.expect(POSITION, AT_2048).expect(SET_GOAL_2048, TAKEN).expect(GOAL, GOAL_5)
    ranged.expect(OFF, TAKEN)
    with pytest.raises(ServoRejectedError, match="keeps goal 5 instead of its position, 2048"):
        torque_on(feetech, 1)


def test_torque_stays_off_if_position_is_unknown(feetech, ranged):
    ranged.expect(POSITION)
    with pytest.raises(ServoSilentError):
        torque_on(feetech, 1)


def test_torque_stays_off_at_wrong_supply_voltage(feetech, line):
    line.expect(VOLTAGE, "FF FF 01 03 00 C8 33").expect(LOWEST, LOWEST_4)
    line.expect(HIGHEST, HIGHEST_14)
    with pytest.raises(
        ServoAlarmError,
        match=r"has a supply voltage of 20\.0 V; its own limits are 4\.0 to 14\.0 V",
    ):
        torque_on(feetech, 1)


def test_torque_on_check_returns_supply_voltage_inside_limits(feetech, fed):
    assert check_supply_voltage(feetech, 1) == pytest.approx(12.0)


def test_torque_off_reaches_second_servo_if_first_is_silent(feetech, line):
    line.expect(OFF).expect("FF FF 02 04 03 28 00 CE", "FF FF 02 02 00 FB")
    errors = torque_off(feetech, [1, 2])
    assert list(errors) == [1]

"""EEPROM is written only where it differs, verified, and locked again."""

from __future__ import annotations

import pytest

from ikservo.errors import RegisterAccessError, ServoRejectedError, ServoSilentError
from ikservo.hardware import register_differences, update_eeprom
from ikservo.registers import STS3215

from .packets import reply, request

TAKEN = "FF FF 01 02 00 FC"
READ_OFFSET, OFFSET_0 = "FF FF FE 05 82 1F 02 01 58", "FF FF 01 04 00 00 00 FA"
OFFSET_MINUS_100 = "FF FF 01 04 00 64 08 8E"
TORQUE, LIMP, ON = "FF FF 01 04 02 28 01 CF", "FF FF 01 03 00 00 FB", "FF FF 01 03 00 01 FA"
READ_LOCK, OPEN, LOCKED = "FF FF 01 04 02 37 01 C0", LIMP, ON
UNLOCK, LOCK = "FF FF 01 04 03 37 00 C0", "FF FF 01 04 03 37 01 BF"
WRITE_MINUS_100 = "FF FF 01 05 03 1F 64 08 6B"
WANTED = {STS3215.homing_offset: -100}


def test_unchanged_eeprom_value_is_not_written(feetech, line):
    line.expect(READ_OFFSET, OFFSET_MINUS_100).expect(READ_LOCK, LOCKED)
    assert update_eeprom(feetech, 1, WANTED) == []


def test_eeprom_found_unlocked_is_locked(feetech, line):
    line.expect(READ_OFFSET, OFFSET_MINUS_100).expect(READ_LOCK, OPEN).expect(LOCK, TAKEN)
    assert update_eeprom(feetech, 1, WANTED) == []


def test_eeprom_change_is_unlocked_written_verified_and_locked(feetech, line):
    line.expect(READ_OFFSET, OFFSET_0).expect(TORQUE, LIMP).expect(UNLOCK, TAKEN)
    line.expect(WRITE_MINUS_100, TAKEN).expect(READ_OFFSET, OFFSET_MINUS_100).expect(LOCK, TAKEN)
    (change,) = update_eeprom(feetech, 1, WANTED)
    assert (change.register, change.found, change.expected) == (STS3215.homing_offset, 0, -100)


def test_eeprom_is_locked_and_checked_after_lost_reply(feetech, line):
    line.expect(READ_OFFSET, OFFSET_0).expect(TORQUE, LIMP).expect(UNLOCK, TAKEN)
    line.expect(WRITE_MINUS_100)
    line.expect(LOCK, TAKEN)  # this may be the lost answer, late: both look alike
    line.expect(request(1, 54, 2), reply(1, 0, 1))
    with pytest.raises(ServoSilentError):
        update_eeprom(feetech, 1, WANTED)


def test_eeprom_value_that_does_not_persist_is_reported(feetech, line):
    line.expect(READ_OFFSET, OFFSET_0).expect(TORQUE, LIMP).expect(UNLOCK, TAKEN)
    line.expect(WRITE_MINUS_100, TAKEN).expect(READ_OFFSET, OFFSET_0).expect(LOCK, TAKEN)
    with pytest.raises(ServoRejectedError, match="homing_offset = 0 after -100 was written"):
        update_eeprom(feetech, 1, WANTED)


def test_eeprom_update_under_torque_writes_nothing(feetech, line):
    line.expect(READ_OFFSET, OFFSET_0).expect(TORQUE, ON)
    with pytest.raises(RegisterAccessError, match="torque is on"):
        update_eeprom(feetech, 1, WANTED)


@pytest.mark.parametrize(
    ("register", "why"),
    [(STS3215.goal_position, "not in EEPROM"), (STS3215.id, "no longer answer on this bus")],
)
def test_eeprom_update_of_unsuitable_register_sends_nothing(feetech, register, why):
    with pytest.raises(RegisterAccessError, match=why):
        update_eeprom(feetech, 1, {register: 7})


def test_comparing_registers_writes_nothing(feetech, line):
    line.expect(READ_OFFSET, OFFSET_0)
    (difference,) = register_differences(feetech, 1, WANTED)
    assert difference.expected == -100

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


def test_what_holds_already_is_not_written(feetech, line):
    line.expect(READ_OFFSET, OFFSET_MINUS_100).expect(READ_LOCK, LOCKED)
    assert update_eeprom(feetech, 1, WANTED) == []


def test_a_lock_that_an_earlier_run_left_open_is_closed(feetech, line):
    line.expect(READ_OFFSET, OFFSET_MINUS_100).expect(READ_LOCK, OPEN).expect(LOCK, TAKEN)
    assert update_eeprom(feetech, 1, WANTED) == []


def test_what_differs_is_unlocked_written_verified_and_locked(feetech, line):
    line.expect(READ_OFFSET, OFFSET_0).expect(TORQUE, LIMP).expect(UNLOCK, TAKEN)
    line.expect(WRITE_MINUS_100, TAKEN).expect(READ_OFFSET, OFFSET_MINUS_100).expect(LOCK, TAKEN)
    (change,) = update_eeprom(feetech, 1, WANTED)
    assert (change.register, change.found, change.expected) == (STS3215.homing_offset, 0, -100)


def test_it_is_locked_again_after_a_lost_answer_and_the_lock_is_checked(feetech, line):
    line.expect(READ_OFFSET, OFFSET_0).expect(TORQUE, LIMP).expect(UNLOCK, TAKEN)
    line.expect(WRITE_MINUS_100)
    line.expect(LOCK, TAKEN)  # this may be the lost answer, late: both look alike
    line.expect(request(1, 54, 2), reply(1, 0, 1))
    with pytest.raises(ServoSilentError):
        update_eeprom(feetech, 1, WANTED)


def test_a_number_that_does_not_last_is_reported(feetech, line):
    line.expect(READ_OFFSET, OFFSET_0).expect(TORQUE, LIMP).expect(UNLOCK, TAKEN)
    line.expect(WRITE_MINUS_100, TAKEN).expect(READ_OFFSET, OFFSET_0).expect(LOCK, TAKEN)
    with pytest.raises(ServoRejectedError, match="homing_offset = 0 after -100 was written"):
        update_eeprom(feetech, 1, WANTED)


def test_under_torque_nothing_is_written(feetech, line):
    line.expect(READ_OFFSET, OFFSET_0).expect(TORQUE, ON)
    with pytest.raises(RegisterAccessError, match="torque is on"):
        update_eeprom(feetech, 1, WANTED)


@pytest.mark.parametrize(
    ("register", "why"),
    [(STS3215.goal_position, "not in EEPROM"), (STS3215.id, "no longer answer on this bus")],
)
def test_what_does_not_belong_here_is_refused_before_a_byte_is_sent(feetech, register, why):
    with pytest.raises(RegisterAccessError, match=why):
        update_eeprom(feetech, 1, {register: 7})


def test_differences_change_nothing(feetech, line):
    line.expect(READ_OFFSET, OFFSET_0)
    (difference,) = register_differences(feetech, 1, WANTED)
    assert difference.expected == -100

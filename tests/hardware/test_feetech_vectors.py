"""Packets to and from Feetech servos, each as one literal byte string."""

from __future__ import annotations

import pytest

from ikservo.hardware import Port, ServoBus, ServoSpec
from ikservo.registers import STS3215, Alarm, RegisterName

from .packets import packet

SWITCHED_ON = ("FF FF 01 04 03 28 01 CE", "FF FF 01 02 00 FC")


def test_ping_reads_model_number(feetech, line):
    line.expect("FF FF 01 02 01 FB", "FF FF 01 02 00 FC")
    line.expect("FF FF 01 04 02 03 02 F3", "FF FF 01 04 00 09 03 EE")
    assert feetech.ping(1).model_number == 777


def test_read_of_position_matches_manual_bytes(feetech, line):
    line.expect("FF FF 01 04 02 38 02 BE", "FF FF 01 04 00 00 08 F2")
    assert feetech.read(1, STS3215.present_position, raw=True) == 2048


def test_position_is_read_in_radians(feetech, line):
    line.expect("FF FF 01 04 02 38 02 BE", "FF FF 01 04 00 00 08 F2")
    assert feetech.read(1, STS3215.present_position) == pytest.approx(3.14159265)


def test_position_stays_valid_with_overload_alarm(feetech, line):
    line.expect("FF FF 01 04 02 38 02 BE", "FF FF 01 04 20 00 08 D2")
    assert feetech.read(1, STS3215.present_position, raw=True) == 2048
    assert feetech.alarms[1] == {Alarm.OVERLOAD}


def test_torque_enable_write_matches_manual_bytes(feetech, line):
    line.expect("FF FF 01 04 03 28 01 CE", "FF FF 01 02 00 FC")
    feetech.write(1, STS3215.torque_enable, 1)


def test_middle_position_write_matches_manual_bytes(feetech, line):
    line.expect("FF FF 01 04 03 28 80 4F", "FF FF 01 02 00 FC")
    feetech.write(1, STS3215.torque_enable, 128)


def test_goal_write_matches_manual_bytes(feetech, line):
    line.expect(*SWITCHED_ON)
    feetech.write(1, STS3215.torque_enable, 1)
    line.expect("FF FF 01 05 03 2A 00 08 C4", "FF FF 01 02 00 FC")
    feetech.write(1, STS3215.goal_position, 2048, raw=True)


def test_negative_offset_is_written_with_sign_bit(feetech, line):
    line.expect("FF FF 01 05 03 1F 64 08 6B", "FF FF 01 02 00 FC")
    feetech.write(1, STS3215.homing_offset, -100, raw=True)


def test_eeprom_unlock_matches_manual_bytes(feetech, line):
    line.expect("FF FF 01 04 03 37 00 C0", "FF FF 01 02 00 FC")
    feetech.write(1, STS3215.lock, 0)


def test_registered_write_and_action_match_manual_bytes(feetech, line):
    line.expect(*SWITCHED_ON)
    feetech.write(1, STS3215.torque_enable, 1)
    line.expect("FF FF 01 05 04 2A 00 08 C3", "FF FF 01 02 00 FC")
    line.expect("FF FF 01 04 02 28 01 CF", "FF FF 01 03 00 01 FA")  # is its torque still on?
    line.expect("FF FF FE 02 05 FA")
    feetech.reg_write(1, STS3215.goal_position, 2048, raw=True)
    feetech.action()


def test_sync_write_of_goals_matches_manual_bytes(feetech, line):
    line.expect(packet(0xFE, 0x83, 40, 1, 1, 1, 2, 1))
    feetech.sync_write(RegisterName.TORQUE_ENABLE, {1: 1, 2: 1}, raw=True)
    line.expect("FF FF FE 0A 83 2A 02 01 00 08 02 FF 07 37")
    feetech.sync_write(RegisterName.GOAL_POSITION, {1: 2048, 2: 2047}, raw=True)


def test_sync_read_of_positions_matches_manual_bytes(feetech, line):
    line.expect(
        "FF FF FE 06 82 38 02 01 02 3C", "FF FF 01 04 00 00 08 F2", "FF FF 02 04 00 FF 07 F3"
    )
    readings = feetech.sync_read([1, 2], RegisterName.PRESENT_POSITION, raw=True)
    assert readings.require_all() == {1: 2048, 2: 2047}


def test_reboot_of_unsupporting_servo_is_refused_without_bytes(feetech, line):
    with pytest.raises(Exception, match="does not support reboot"):
        feetech.reboot(1)
    assert line.sent == []


def test_negative_speed_is_read_with_sign_bit(line):
    bus = ServoBus(Port(line, "scripted", 1_000_000), [ServoSpec(1, STS3215)])
    line.expect("FF FF 01 04 02 3A 02 BC", "FF FF 01 04 00 32 80 48")
    assert bus.read(1, STS3215.present_speed, raw=True) == -50

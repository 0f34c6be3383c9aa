"""Packets to and from Dynamixels, each as one literal byte string."""

from __future__ import annotations

import pytest

from ikservo.errors import ServoRejectedError
from ikservo.hardware import PingResult
from ikservo.hardware.protocols.dynamixel import DynamixelDriver
from ikservo.registers import XL430W250, Alarm, RegisterName

TAKEN = "FF FF FD 00 01 04 00 55 00 A1 0C"


def test_ping_returns_model_and_firmware(dynamixel, line):
    line.expect("FF FF FD 00 01 03 00 01 19 4E", "FF FF FD 00 01 07 00 55 00 06 04 26 65 5D")
    assert dynamixel.ping(1) == PingResult(1, model_number=1030, firmware=0x26)


def test_read_of_position_matches_manual_bytes(dynamixel, line):
    line.expect(
        "FF FF FD 00 01 07 00 02 84 00 04 00 1D 15", "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0"
    )
    assert dynamixel.read(1, XL430W250.present_position, raw=True) == 166


def test_read_of_hardware_error_matches_manual_bytes(dynamixel, line):
    line.expect("FF FF FD 00 01 07 00 02 46 00 01 00 3C A3", "FF FF FD 00 01 05 00 55 80 20 99 21")
    assert dynamixel.read_alarms(1) == {Alarm.OVERLOAD}


@pytest.mark.parametrize(
    ("value", "packet"),
    [
        (1, "FF FF FD 00 01 06 00 03 40 00 01 DB 66"),
        (0, "FF FF FD 00 01 06 00 03 40 00 00 DE E6"),
    ],
)
def test_torque_enable_write_matches_manual_bytes(dynamixel, line, value, packet):
    line.expect(packet, TAKEN)
    dynamixel.write(1, XL430W250.torque_enable, value)


def test_goal_write_matches_manual_bytes(dynamixel, line):
    line.expect("FF FF FD 00 01 06 00 03 40 00 01 DB 66", TAKEN)
    dynamixel.write(1, XL430W250.torque_enable, 1)
    line.expect("FF FF FD 00 01 09 00 03 74 00 00 02 00 00 CA 89", TAKEN)
    dynamixel.write(1, XL430W250.goal_position, 512, raw=True)


def test_goal_with_header_bytes_is_stuffed(line, port):
    line.expect("FF FF FD 00 01 0A 00 03 74 00 FF FF FD FD 00 21 E7", TAKEN)
    DynamixelDriver(port).write(1, 116, bytes.fromhex("FF FF FD 00"))


def test_registered_write_and_action_match_manual_bytes(dynamixel, line):
    line.expect("FF FF FD 00 01 09 00 04 68 00 C8 00 00 00 AE 8E", TAKEN)
    line.expect("FF FF FD 00 FE 03 00 05 2A C2")
    dynamixel.reg_write(1, XL430W250.goal_velocity, 200, raw=True)
    dynamixel.action()


def test_reboot_matches_manual_bytes(dynamixel, line):
    line.expect("FF FF FD 00 01 03 00 08 2F 4E", TAKEN)
    dynamixel.reboot(1)


def test_watchdog_of_100_ms_matches_manual_bytes(dynamixel, line):
    line.expect("FF FF FD 00 01 06 00 03 62 00 05 68 E4", TAKEN)
    dynamixel.write(1, XL430W250.bus_watchdog, 0.1)


def test_sync_read_of_positions_matches_manual_bytes(dynamixel, line):
    line.expect(
        "FF FF FD 00 FE 09 00 82 84 00 04 00 01 02 CE FA",
        "FF FF FD 00 01 08 00 55 00 A6 00 00 00 8C C0",
        "FF FF FD 00 02 08 00 55 00 1F 08 00 00 BA BE",
    )
    readings = dynamixel.sync_read([1, 2], RegisterName.PRESENT_POSITION, raw=True)
    assert readings.require_all() == {1: 166, 2: 2079}


def test_sync_write_of_goals_matches_manual_bytes(dynamixel, line):
    line.expect("FF FF FD 00 FE 0B 00 83 40 00 01 00 01 01 02 01 C7 64")
    dynamixel.sync_write(RegisterName.TORQUE_ENABLE, {1: 1, 2: 1}, raw=True)
    line.expect("FF FF FD 00 FE 11 00 83 74 00 04 00 01 00 08 00 00 02 00 04 00 00 98 4C")
    dynamixel.sync_write(RegisterName.GOAL_POSITION, {1: 2048, 2: 1024}, raw=True)


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        ("FF FF FD 00 01 04 00 55 04 BA 8C", "out of range"),
        ("FF FF FD 00 01 04 00 55 07 B0 8C", "denies access"),
    ],
)
def test_rejected_write_reports_reason(dynamixel, line, answer, words):
    line.expect("FF FF FD 00 01 06 00 03 40 00 01 DB 66", answer)
    with pytest.raises(ServoRejectedError, match=words):
        dynamixel.write(1, XL430W250.torque_enable, 1)

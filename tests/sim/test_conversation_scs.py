"""Feetech SCS servos: big-endian, ten bits, no sync read."""

from __future__ import annotations

import pytest

from servosim.frames import Dynamixel1Reader, encode1


def ask(port, id_, instruction, params=b""):
    port.write(encode1(id_, instruction, bytes(params)))
    answers = Dynamixel1Reader().feed(port.read(4096))
    return [(frame.id, frame.instruction, frame.params) for frame in answers]


def test_scs_goal_of_manual_is_written_big_endian(make_port):
    port = make_port("SCS0009")
    port.write(bytes.fromhex("FFFF0105032A0200CA"))
    port.read(6)
    assert port.line.servos[1].read("goal_position") == 512


def test_scs_position_is_read_big_endian(make_port):
    assert ask(make_port("SCS0009"), 1, 2, b"\x38\x02") == [(1, 0, b"\x02\x00")]


def test_scs_register_2_states_byte_order(make_port):
    assert ask(make_port("SCS15"), 1, 2, b"\x02\x01") == [(1, 0, b"\x01")]


def test_scs_sync_read_is_not_answered(make_port):
    assert ask(make_port("SCS0009"), 254, 0x82, b"\x38\x02\x01") == []


def test_scs_broadcast_ping_is_not_answered(make_port):
    assert ask(make_port("SCS0009"), 254, 1) == []


def test_sts_servo_answers_sync_read_on_bus_shared_with_scs(make_port):
    port = make_port("SCS0009", "STS3215")
    assert [a[0] for a in ask(port, 254, 0x82, b"\x38\x02\x01\x02")] == [2]


@pytest.mark.parametrize("model", ["SCS0009", "SCS15"])
def test_scs_motion_reaches_goal(make_port, model):
    port = make_port(model)
    servo = port.line.servos[1]
    servo.write("torque_enable", 1)
    servo.write("goal_position", 700)
    port.clock.sleep_until(3)
    assert servo.read("present_position") == pytest.approx(700, abs=5)  # dead zone 2, no start-up


def test_scs_goal_time_sets_speed_if_goal_speed_is_zero(make_port):
    port = make_port("SCS0009")
    servo = port.line.servos[1]
    servo.write("torque_enable", 1)
    servo.write_bytes(42, bytes.fromhex("0320 03E8 0000"))  # 800 in 1000 ms
    port.clock.sleep_until(0.5)
    assert servo.read("present_position") == pytest.approx(656, abs=20)


def test_scs_limits_of_zero_select_motor_mode(make_port):
    port = make_port("SCS15")
    servo = port.line.servos[1]
    servo.write("max_position_limit", 0)
    servo.write("torque_enable", 1)
    servo.write("goal_time", -300)
    port.clock.sleep_until(0.2)
    assert servo.read("present_load") < -200


def test_scs_eeprom_survives_power_cycle_if_unlocked(make_port):
    servo = make_port("SCS0009").line.servos[1]
    servo.write("lock", 0)
    servo.write("id", 9)
    servo.power_up()
    assert servo.read("id") == 9

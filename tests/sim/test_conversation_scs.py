"""Feetech SCS servos: big-endian, ten bits, no sync read."""

from __future__ import annotations

import pytest

from servosim.frames import Dynamixel1Reader, encode1


def ask(port, id_, instruction, params=b""):
    port.write(encode1(id_, instruction, bytes(params)))
    answers = Dynamixel1Reader().feed(port.read(4096))
    return [(frame.id, frame.instruction, frame.params) for frame in answers]


def test_the_manuals_big_endian_goal_is_512(make_port):
    port = make_port("SCS0009")
    port.write(bytes.fromhex("FFFF0105032A0200CA"))
    port.read(6)
    assert port.line.servos[1].read("goal_position") == 512


def test_positions_are_read_big_endian(make_port):
    assert ask(make_port("SCS0009"), 1, 2, b"\x38\x02") == [(1, 0, b"\x02\x00")]


def test_register_2_tells_the_byte_order(make_port):
    assert ask(make_port("SCS15"), 1, 2, b"\x02\x01") == [(1, 0, b"\x01")]


def test_a_sync_read_is_not_answered(make_port):
    assert ask(make_port("SCS0009"), 254, 0x82, b"\x38\x02\x01") == []


def test_a_broadcast_ping_is_not_answered(make_port):
    assert ask(make_port("SCS0009"), 254, 1) == []


def test_an_sts_on_the_same_line_still_answers_the_sync_read(make_port):
    port = make_port("SCS0009", "STS3215")
    assert [a[0] for a in ask(port, 254, 0x82, b"\x38\x02\x01\x02")] == [2]


@pytest.mark.parametrize("model", ["SCS0009", "SCS15"])
def test_a_motion_arrives(make_port, model):
    port = make_port(model)
    servo = port.line.servos[1]
    servo.write("torque_enable", 1)
    servo.write("goal_position", 700)
    port.clock.sleep_until(3)
    assert servo.read("present_position") == pytest.approx(700, abs=5)  # dead zone 2, no start-up


def test_without_a_speed_the_time_decides(make_port):
    port = make_port("SCS0009")
    servo = port.line.servos[1]
    servo.write("torque_enable", 1)
    servo.write_bytes(42, bytes.fromhex("0320 03E8 0000"))  # 800 in 1000 ms
    port.clock.sleep_until(0.5)
    assert servo.read("present_position") == pytest.approx(656, abs=20)


def test_both_limits_zero_make_a_motor(make_port):
    port = make_port("SCS15")
    servo = port.line.servos[1]
    servo.write("max_position_limit", 0)
    servo.write("torque_enable", 1)
    servo.write("goal_time", -300)
    port.clock.sleep_until(0.2)
    assert servo.read("present_load") < -200


def test_eeprom_survives_the_power_only_unlocked_by_register_48(make_port):
    servo = make_port("SCS0009").line.servos[1]
    servo.write("lock", 0)
    servo.write("id", 9)
    servo.power_up()
    assert servo.read("id") == 9

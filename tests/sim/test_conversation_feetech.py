"""Packets to and from Feetech STS servos."""

from __future__ import annotations

import pytest

from servosim.frames import Dynamixel1Reader, encode1


def ask(port, id_, instruction, params=b""):
    """Send one frame; return all status packets as (id, error, data)."""
    port.write(encode1(id_, instruction, bytes(params)))
    answers = Dynamixel1Reader().feed(port.read(4096))
    return [(frame.id, frame.instruction, frame.params) for frame in answers]


def test_ping_is_answered_as_in_manual(make_port):
    port = make_port("STS3215")
    port.write(bytes.fromhex("FFFF010201FB"))
    assert port.read(6).hex() == "ffff010200fc"


def test_position_read_is_answered_as_in_manual(make_port):
    port = make_port("STS3215")
    port.write(bytes.fromhex("FFFF0104023802BE"))
    assert port.read(8).hex() == "ffff0104000008f2"


def test_model_number_is_read_from_register(make_port):
    assert ask(make_port("STS3215"), 1, 0x02, b"\x03\x02") == [(1, 0, b"\x09\x03")]


def test_broadcast_ping_is_answered_by_all(make_port):
    port = make_port("STS3215", "STS3215")
    assert [a[0] for a in ask(port, 254, 0x01)] == [1, 2]


def test_sync_read_is_answered_in_order_of_list(make_port):
    port = make_port("STS3215", "STS3215")
    assert [a[0] for a in ask(port, 254, 0x82, b"\x38\x02\x02\x01")] == [2, 1]


def test_sync_write_example_of_manual_sets_both_goals(make_port):
    port = make_port("STS3215", "STS3215")
    port.write(bytes.fromhex("FFFFFE0A832A0201000802FF0737"))
    port.clock.sleep_until(0.01)
    goals = [port.line.servos[k].read("goal_position") for k in (1, 2)]
    assert goals == [2048, 2047]


@pytest.mark.parametrize(("beyond", "is_done"), [(0, True), (1, False)])
def test_write_beyond_last_byte_of_table_changes_nothing(make_port, beyond, is_done):
    port = make_port("STS3215")
    servo, address = port.line.servos[1], 0x2A
    length = servo.table.size - address + beyond
    ask(port, 1, 0x03, [address, *(1500).to_bytes(2, "little"), *bytes(length - 2)])
    assert (servo.read("goal_position") == 1500) is is_done


def test_write_instruction_without_data_is_refused(make_port):
    servo = make_port("STS3215").line.servos[1]
    assert servo.check_write(0x2A, b"") is not None


def test_negative_homing_offset_is_sign_magnitude(make_port):
    port = make_port("STS3215")
    port.write(bytes.fromhex("FFFF0105031F64086B"))
    port.read(6)
    assert port.line.servos[1].read("homing_offset") == -100


def test_present_position_is_actual_minus_homing_offset(make_port):
    port = make_port("STS3215")
    ask(port, 1, 0x03, b"\x1f\x64\x08")
    assert port.line.servos[1].read("present_position") == 2148


def test_present_position_wraps_into_one_turn(make_port):
    port = make_port("STS3215")
    port.line.world.place("servo_1", 3.5)
    assert port.line.servos[1].read("present_position") == 2048 + 2282 - 4096


def test_sts_phase_bit_4_enables_multi_turn_position(make_port):
    port = make_port("STS3215")
    servo = port.line.servos[1]
    servo.write("phase", 12 | 16)
    port.line.world.place("servo_1", 3.5)
    assert servo.read("present_position") == 2048 + 2282


def test_torque_register_128_sets_present_position_to_2048(make_port):
    port = make_port("STS3215")
    port.line.world.place("servo_1", 0.5)
    ask(port, 1, 0x03, b"\x28\x80")
    servo = port.line.servos[1]
    assert (servo.read("present_position"), servo.read("homing_offset")) == (2048, 326)


@pytest.mark.parametrize("goal", [1500, 2500])
def test_torque_register_128_during_motion_stops_servo(make_port, goal):
    port = make_port("STS3215")
    servo, clock = port.line.servos[1], port.clock
    servo.write("torque_enable", 1)
    servo.write("goal_position", goal)
    clock.sleep_until(clock.now_s() + 0.15)
    assert abs(servo.read("present_position") - 2048) > 200
    servo.write("torque_enable", 128)
    assert servo.read("goal_position") == 2048
    clock.sleep_until(clock.now_s() + 1.0)
    assert (servo.read("torque_enable"), servo.read("present_position")) == (
        1, pytest.approx(2048, abs=10))  # fmt: skip


def test_torque_register_128_does_not_switch_torque_on(make_port):
    port = make_port("STS3215")
    ask(port, 1, 0x03, b"\x28\x80")
    assert not port.line.servos[1].drive.torque_on


@pytest.mark.parametrize(("lock", "kept"), [(1, 1), (0, 7)])
def test_eeprom_write_survives_power_cycle_only_if_unlocked(make_port, lock, kept):
    port = make_port("STS3215")
    servo = port.line.servos[1]
    servo.write("lock", lock)
    servo.write("id", 7)
    servo.power_up()
    assert servo.read("id") == kept


def test_unlocked_servo_is_locked_after_power_up(make_port):
    servo = make_port("STS3215").line.servos[1]
    servo.write("lock", 0)
    servo.power_up()
    assert servo.read("lock") == 1


def test_sts_goal_beyond_limits_moves_servo_to_limit(make_port):
    port = make_port("STS3215")
    servo = port.line.servos[1]
    servo.write("max_position_limit", 2200)
    servo.write("torque_enable", 1)
    servo.write("goal_position", 3000)
    port.clock.sleep_until(2.0)
    assert servo.read("present_position") == pytest.approx(2200, abs=3)


def test_write_to_measured_register_is_ignored(make_port):
    port = make_port("STS3215")
    ask(port, 1, 0x03, b"\x38\x00\x00")
    assert port.line.servos[1].read("present_position") == 2048


def test_write_is_not_answered_at_response_level_0(make_port):
    port = make_port("STS3215")
    port.line.servos[1].write("response_level", 0)
    assert (ask(port, 1, 0x03, b"\x29\x14"), len(ask(port, 1, 0x01))) == ([], 1)


def test_registered_write_waits_for_action(make_port):
    port = make_port("STS3215")
    ask(port, 1, 0x04, b"\x2a\x00\x09")
    servo = port.line.servos[1]
    before = servo.read("goal_position"), servo.read("async_write")
    ask(port, 254, 0x05)
    after = servo.read("goal_position"), servo.read("async_write")
    assert (before, after) == ((2048, 1), (2304, 0))


def test_reboot_is_not_answered_and_takes_0_7_to_0_9_s(make_port):
    port = make_port("STS3215")
    port.line.servos[1].write("acceleration", 9)
    answers = [ask(port, 1, 0x08), ask(port, 1, 0x01)]
    port.clock.sleep_until(0.7)
    answers.append(ask(port, 1, 0x01))
    port.clock.sleep_until(0.9)
    assert [*answers, ask(port, 1, 0x01)] == [[], [], [], [(1, 0, b"")]]
    assert port.line.servos[1].read("acceleration") == 0


def test_recovery_instruction_restores_backup(make_port):
    port = make_port("STS3215")
    servo = port.line.servos[1]
    servo.write("lock", 0)
    servo.write("p_gain", 16)
    assert ask(port, 1, 0x09) == [(1, 0, b"")]
    servo.write("p_gain", 8)
    ask(port, 1, 0x06)
    assert servo.read("p_gain") == 16


@pytest.mark.parametrize("wanted", [0, 1000, 2048, 4095])
def test_calibration_instruction_sets_present_position(make_port, wanted):
    port = make_port("STS3215")
    port.line.world.place("servo_1", 0.5)
    assert ask(port, 1, 0x0B, wanted.to_bytes(2, "little")) == [(1, 0, b"")]
    assert port.line.servos[1].read("present_position") == wanted


def test_goal_write_switches_torque_on(make_port):
    servo = make_port("STS3215").line.servos[1]
    servo.write("goal_position", 2148)
    assert (servo.read("torque_enable"), servo.drive.torque_on) == (1, True)


def test_sim_option_keeps_torque_off_at_goal_write(make_port):
    port = make_port("STS3215")
    port.line.world.keep_torque_with_goals()
    servo = port.line.servos[1]
    servo.write("goal_position", 2148)
    assert (servo.read("torque_enable"), servo.drive.torque_on) == (0, False)


def test_goal_write_does_not_switch_torque_on_during_alarm(make_port):
    port = make_port("STS3215")
    servo = port.line.servos[1]
    servo.inject_alarm(0x04)
    servo.write("goal_position", 2148)
    assert not servo.drive.torque_on


@pytest.mark.parametrize(("goal", "driven_to"), [(3100, 3000), (3900, 500), (100, 500)])
def test_sts_goal_is_clamped_to_nearer_limit_on_circle(make_port, goal, driven_to):
    servo = make_port("STS3215").line.servos[1]
    servo.write("min_position_limit", 500)
    servo.write("max_position_limit", 3000)
    servo.write("goal_position", goal)
    assert (servo.clamped_goal(), servo.read("goal_position")) == (driven_to, goal)


@pytest.mark.parametrize("goal_speed", [0, 3000])
def test_max_speed_limit_caps_goal_speed(make_port, goal_speed):
    port = make_port("STS3215")
    servo = port.line.servos[1]
    servo.write("max_speed_limit", 20)
    servo.write("goal_speed", goal_speed)
    servo.write("goal_position", 4000)
    port.clock.sleep_until(0.5)
    first = servo.read("present_position")
    port.clock.sleep_until(1.0)
    assert servo.read("present_position") - first == pytest.approx(500, abs=15)


def test_duplicate_ids_with_different_positions_corrupt_replies(make_port):
    port = make_port("STS3215", "STS3215", ids=(1, 1))
    port.line.world.place("servo_2", 0.7)
    assert ask(port, 1, 0x02, b"\x38\x02") != [(1, 0, b"\x00\x08")]


def test_motion_with_speed_and_acceleration_reaches_goal(make_port):
    port = make_port("STS3215")
    servo = port.line.servos[1]
    for name, value in (("torque_enable", 1), ("acceleration", 50), ("goal_speed", 1000)):
        servo.write(name, value)
    servo.write("goal_position", 3048)
    port.clock.sleep_until(0.6)
    underway = servo.read("present_speed"), servo.read("moving")
    port.clock.sleep_until(2.0)
    assert underway == (pytest.approx(1000, rel=0.03), 1)
    assert servo.read("present_position") == pytest.approx(3048, abs=2)
    assert servo.read("moving") == 0

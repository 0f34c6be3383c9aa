"""Packets in protocol 2.0, byte for byte, with loose servos."""

from __future__ import annotations

import pytest

from servosim.frames import Dynamixel2Reader, encode2

STATUS = 0x55


def ask(port, id_, instruction, params=b""):
    """Send one frame; return all status packets as (id, error, data)."""
    port.write(encode2(id_, instruction, bytes(params)))
    answers = Dynamixel2Reader().feed(port.read(4096))
    return [(frame.id, frame.params[0], frame.params[1:]) for frame in answers]


def write(port, id_, address, value, size):
    data = address.to_bytes(2, "little") + value.to_bytes(size, "little", signed=value < 0)
    return ask(port, id_, 0x03, data)


def read(port, id_, address, size):
    request = address.to_bytes(2, "little") + size.to_bytes(2, "little")
    return ask(port, id_, 0x02, request)


def test_ping_returns_model_and_firmware(make_port):
    port = make_port("XM430-W350")
    assert ask(port, 1, 0x01) == [(1, 0, bytes((0xFC, 0x03, 46)))]


def test_goal_write_is_answered_as_in_manual(make_port):
    port = make_port("XM430-W350")
    port.write(bytes.fromhex("FFFFFD00010900037400000200 00CA89".replace(" ", "")))
    assert port.read(64).hex() == "fffffd000104005500a10c"


def test_centred_dynamixel_reads_position_2048(make_port):
    assert read(make_port("XL430-W250"), 1, 132, 4) == [(1, 0, b"\x00\x08\x00\x00")]


def test_read_across_register_gap_returns_zero_bytes(make_port):
    assert read(make_port("XL430-W250"), 1, 64, 6) == [(1, 0, b"\x00\x00\x00\x00\x02\x00")]


def test_read_beyond_table_returns_access_error_without_data(make_port):
    assert read(make_port("XL430-W250"), 1, 660, 4) == [(1, 7, b"")]


def test_unknown_instruction_returns_instruction_error(make_port):
    assert ask(make_port("XL430-W250"), 1, 0x77) == [(1, 2, b"")]


@pytest.mark.parametrize(
    ("address", "value", "size", "error"),
    [
        (132, 100, 4, 7),  # present position is read-only
        (14, 1, 1, 7),  # a gap
        (700, 1, 1, 7),  # behind the table
        (9, 255, 1, 4),  # return delay goes to 254
        (116, 4096, 4, 4),  # goal outside the position limits
        (116, 512, 2, 5),  # half a register
        (11, 0, 1, 4),  # XL430 has no current mode
        (116, 512, 4, 0),
    ],
)
def test_write_is_answered_with_error_code_of_table(make_port, address, value, size, error):
    assert write(make_port("XL430-W250"), 1, address, value, size) == [(1, error, b"")]


def test_refused_write_changes_nothing(make_port):
    port = make_port("XL430-W250")
    write(port, 1, 9, 255, 1)
    assert port.line.servos[1].read("return_delay_time") == 250


def test_eeprom_write_with_torque_on_returns_access_error(make_port):
    port = make_port("XL430-W250")
    write(port, 1, 64, 1, 1)
    assert write(port, 1, 9, 0, 1) == [(1, 7, b"")]


def test_registered_write_waits_for_action(make_port):
    port = make_port("XL430-W250")
    ask(port, 1, 0x04, b"\x74\x00\xc8\x00\x00\x00")
    before = port.line.servos[1].read("goal_position"), read(port, 1, 69, 1)
    ask(port, 254, 0x05)
    after = port.line.servos[1].read("goal_position"), read(port, 1, 69, 1)
    assert (before, after) == ((2048, [(1, 0, b"\x01")]), (200, [(1, 0, b"\x00")]))


def test_action_without_registered_write_returns_error(make_port):
    assert ask(make_port("XL430-W250"), 1, 0x05) == [(1, 2, b"")]


def test_broadcast_ping_is_answered_in_order_of_ids(make_port):
    port = make_port("XL430-W250", "XL430-W250", "XL430-W250", ids=(7, 2, 200))
    port.timeout = 1.0
    assert [id_ for id_, _, _ in ask(port, 254, 0x01)] == [2, 7, 200]


def test_sync_read_is_answered_in_order_of_list(make_port):
    port = make_port("XL430-W250", "XL430-W250", "XL430-W250")
    assert [a[0] for a in ask(port, 254, 0x82, b"\x84\x00\x04\x00\x03\x01\x02")] == [3, 1, 2]


def test_sync_read_continues_after_missing_servo(make_port):
    port = make_port("XL430-W250", "XL430-W250")
    assert [a[0] for a in ask(port, 254, 0x82, b"\x84\x00\x04\x00\x01\x09\x02")] == [1, 2]


def test_bulk_read_returns_registers_of_each_servo(make_port):
    port = make_port("XL430-W250", "XL430-W250")
    answers = ask(port, 254, 0x92, b"\x01\x90\x00\x02\x00\x02\x92\x00\x01\x00")
    assert answers == [(1, 0, b"\x78\x00"), (2, 0, b"\x19")]


def test_sync_write_reaches_all_servos_without_answer(make_port):
    port = make_port("XL430-W250", "XL430-W250")
    goals = b"\x74\x00\x04\x00\x01\x96\x00\x00\x00\x02\xaa\x00\x00\x00"
    answers = ask(port, 254, 0x83, goals)
    servos = port.line.servos
    assert (answers, servos[1].read("goal_position"), servos[2].read("goal_position")) == (
        [], 150, 170,
    )  # fmt: skip


def test_bulk_write_reaches_different_registers(make_port):
    port = make_port("XL430-W250", "XL430-W250")
    ask(port, 254, 0x93, b"\x01\x20\x00\x02\x00\x64\x00\x02\x1f\x00\x01\x00\x46")
    servos = port.line.servos
    assert (
        servos[1].read("max_voltage_limit"), servos[2].read("temperature_limit"),
    ) == (100, 70)  # fmt: skip


def test_fast_sync_read_is_answered_in_one_packet(make_port):
    port = make_port("XL430-W250", "XL430-W250")
    port.write(encode2(254, 0x8A, b"\x84\x00\x04\x00\x01\x02"))
    (frame,) = Dynamixel2Reader().feed(port.read(64))
    first, second = b"\x00\x01\x00\x08\x00\x00", b"\x00\x02\x00\x08\x00\x00"
    assert (frame.params[:6], frame.params[8:]) == (first, second)


def test_fast_sync_read_reply_ends_at_missing_servo(make_port):
    port = make_port("XL430-W250", "XL430-W250")
    port.write(encode2(254, 0x8A, b"\x84\x00\x04\x00\x01\x09\x02"))
    assert len(port.read(64)) == 8 + 8


@pytest.mark.parametrize(
    ("level", "answered"), [(0, (True, False, False)), (1, (True, True, False)), (2, (True,) * 3)]
)
def test_status_return_level_decides_which_requests_are_answered(make_port, level, answered):
    port = make_port("XL430-W250")
    port.line.servos[1].write("status_return_level", level)
    asked = ask(port, 1, 0x01), read(port, 1, 132, 4), write(port, 1, 65, 1, 1)
    assert tuple(bool(answers) for answers in asked) == answered


def test_servo_reply_waits_for_return_delay(make_port):
    port = make_port("XL430-W250")
    port.line.servos[1].write("return_delay_time", 100)
    port.write(encode2(1, 0x01))
    port.read(14)
    wire_s = (10 + 14) * 10e-6
    assert port.clock.now_s() - wire_s == pytest.approx(200e-6, abs=5e-6)


def test_back_to_back_packets_get_reply_only_to_first(make_port):
    port = make_port("XM430-W350")
    port.write(5 * encode2(1, 0x01, b""))
    assert len(port.read(5 * 14)) == 14
    port.write(encode2(1, 0x01, b""))
    assert len(port.read(14)) == 14


def test_new_servo_id_takes_effect_at_once(make_port):
    port = make_port("XL430-W250")
    write(port, 1, 7, 42, 1)
    assert (ask(port, 1, 0x01), [a[0] for a in ask(port, 42, 0x01)]) == ([], [42])


def test_servo_at_another_baud_rate_does_not_answer(make_port):
    port = make_port("XL430-W250")
    port.baudrate = 57600
    assert ask(port, 1, 0x01) == []


def test_new_baud_rate_applies_from_next_instruction(make_port):
    port = make_port("XL430-W250")
    answer = write(port, 1, 8, 2, 1)
    port.baudrate = 115200
    assert (answer, len(ask(port, 1, 0x01))) == ([(1, 0, b"")], 1)


def test_rebooting_servo_is_silent_for_about_400_ms(make_port):
    port = make_port("XL430-W250")
    answers = [ask(port, 1, 0x08)]
    for at_s in (0.0, 0.35, 0.45):
        port.clock.sleep_until(at_s)
        answers.append(ask(port, 1, 0x01))
    assert [len(a) for a in answers] == [1, 0, 0, 1]


def test_reboot_clears_ram_and_keeps_eeprom(make_port):
    port = make_port("XL430-W250")
    servo = port.line.servos[1]
    servo.write("temperature_limit", 60)
    servo.write("led", 1)
    ask(port, 1, 0x08)
    assert (servo.read("temperature_limit"), servo.read("led")) == (60, 0)


@pytest.mark.parametrize(("option", "id_", "baud"), [(0xFF, 1, 1), (0x01, 42, 1), (0x02, 42, 3)])
def test_factory_reset_keeps_id_and_baud_by_option(make_port, option, id_, baud):
    port = make_port("XL430-W250", ids=(42,))
    servo = port.line.servos[42]
    ask(port, 42, 0x06, bytes((option,)))
    assert (servo.read("id"), servo.read("baud_rate")) == (id_, baud)


def test_broadcast_factory_reset_of_everything_is_ignored(make_port):
    port = make_port("XL430-W250", ids=(42,))
    ask(port, 254, 0x06, b"\xff")
    assert port.line.servos[42].read("id") == 42


def test_clear_instruction_resets_position_to_one_turn(make_port):
    port = make_port("XL430-W250")
    servo = port.line.servos[1]
    servo.write("operating_mode", 4)
    port.line.world.place("servo_1", 3 * 6.283185307)
    before = servo.read("present_position")
    ask(port, 1, 0x10, b"\x01DXL\x22")
    assert (before, servo.read("present_position")) == (2048 + 3 * 4096, 2048)


def test_servo_obeys_secondary_id_without_reply(make_port):
    port = make_port("XL430-W250", "XL430-W250")
    port.line.servos[2].write("secondary_id", 1)
    answers = write(port, 1, 65, 1, 1)
    assert (answers, port.line.servos[2].read("led")) == ([(1, 0, b"")], 1)


def test_secondary_id_cannot_write_eeprom(make_port):
    port = make_port("XL430-W250", "XL430-W250")
    port.line.servos[2].write("secondary_id", 1)
    write(port, 1, 31, 60, 1)
    assert port.line.servos[2].read("temperature_limit") == 72


def test_hardware_error_sets_alert_bit(make_port):
    port = make_port("XL430-W250")
    port.line.servos[1].watch.raise_alarm(0x20)
    assert read(port, 1, 70, 1) == [(1, 0x80, b"\x20")]


def test_indirect_address_reads_and_writes_its_target(make_port):
    port = make_port("XL430-W250")
    write(port, 1, 168, 65, 2)
    write(port, 1, 224, 1, 1)
    assert (port.line.servos[1].read("led"), read(port, 1, 224, 1)) == (1, [(1, 0, b"\x01")])


def test_duplicate_ids_corrupt_ping_reply(make_port):
    port = make_port("XL430-W250", "XL330-M288", ids=(1, 1))
    assert ask(port, 1, 0x01) != [(1, 0, bytes((0x24, 0x04, 46)))]


def test_bus_watchdog_makes_goals_read_only_after_time_out(make_port):
    port = make_port("XL430-W250")
    write(port, 1, 64, 1, 1)
    write(port, 1, 98, 5, 1)
    port.clock.sleep_until(port.clock.now_s() + 0.2)
    status = read(port, 1, 98, 1), write(port, 1, 116, 2100, 4)
    assert status == ([(1, 0, b"\xff")], [(1, 4, b"")])


def test_bus_watchdog_is_cleared_by_zero(make_port):
    port = make_port("XL430-W250")
    write(port, 1, 64, 1, 1)
    write(port, 1, 98, 5, 1)
    port.clock.sleep_until(port.clock.now_s() + 0.2)
    write(port, 1, 98, 0, 1)
    assert write(port, 1, 116, 2100, 4) == [(1, 0, b"")]

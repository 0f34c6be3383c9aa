"""Packets in protocol 1.0: AX-12A, MX-28, and an X-series servo in that protocol."""

from __future__ import annotations

import pytest

from servosim.assembly import BenchServo, make_bench_world
from servosim.errors import SimulatorError
from servosim.frames import Dynamixel1Reader, encode1
from servosim.line import Line
from servosim.port import SimulatedPort


def ask(port, id_, instruction, params=b""):
    """Send one frame; return all status packets as (id, error, data)."""
    port.write(encode1(id_, instruction, bytes(params)))
    answers = Dynamixel1Reader().feed(port.read(4096))
    return [(frame.id, frame.instruction, frame.params) for frame in answers]


def run(port, seconds):
    port.clock.sleep_until(port.clock.now_s() + seconds)


def test_temperature_read_is_answered_as_in_manual(make_port):
    port = make_port("AX-12A")
    port.write(bytes.fromhex("FFFF0104022B01CC"))
    assert port.read(64).hex() == "ffff010300 19 e2".replace(" ", "")


@pytest.mark.parametrize(("model", "number"), [("AX-12A", 12), ("MX-28", 29)])
def test_model_number_is_read_from_register(make_port, model, number):
    assert ask(make_port(model), 1, 2, b"\x00\x02") == [(1, 0, bytes((number, 0)))]


def test_broadcast_ping_is_not_answered(make_port):
    assert ask(make_port("AX-12A"), 254, 1) == []


@pytest.mark.parametrize(
    ("params", "error"),
    [
        (b"\x24\x00\x02", 0x08),  # present position is read-only
        (b"\x10\x03", 0x08),  # status return level goes to 2
        (b"\x1e\x00\x04", 0x08),  # goal 1024
        (b"\x1e\x00\x02", 0x00),
    ],
)
def test_write_returns_range_error_if_table_forbids_it(make_port, params, error):
    assert ask(make_port("AX-12A"), 1, 3, params) == [(1, error, b"")]


def test_goal_outside_angle_limits_returns_angle_limit_error(make_port):
    port = make_port("AX-12A")
    port.line.servos[1].write("ccw_angle_limit", 600)
    assert ask(port, 1, 3, b"\x1e\xbc\x02") == [(1, 0x02, b"")]


def test_unknown_instruction_returns_instruction_error(make_port):
    assert ask(make_port("AX-12A"), 1, 0x77) == [(1, 0x40, b"")]


def test_goal_write_switches_torque_on_and_is_reached(make_port):
    port = make_port("AX-12A")
    ask(port, 1, 3, b"\x1e\x58\x02")
    run(port, 2)
    servo = port.line.servos[1]
    assert servo.read("torque_enable") == 1
    assert servo.read("present_position") == pytest.approx(600, abs=3)


def test_moving_speed_limits_motion(make_port):
    port = make_port("MX-28")
    servo = port.line.servos[1]
    servo.write("moving_speed", 100)
    servo.write("goal_position", 4000)
    run(port, 0.5)
    assert servo.read("present_speed") == pytest.approx(100, abs=4)


def test_wheel_mode_is_set_by_angle_limits_of_zero(make_port):
    port = make_port("MX-28")
    servo = port.line.servos[1]
    servo.write("ccw_angle_limit", 0)
    servo.write("torque_enable", 1)
    servo.write("moving_speed", -200)
    run(port, 1)
    assert servo.read("present_speed") == pytest.approx(-200, abs=6)


def test_multi_turn_mode_of_mx_is_set_by_angle_limits_of_4095(make_port):
    port = make_port("MX-28")
    servo = port.line.servos[1]
    servo.write("cw_angle_limit", 4095)
    servo.write("goal_position", 6000)
    run(port, 3)
    assert servo.read("present_position") == pytest.approx(6000, abs=8)


def test_ax_lock_register_cannot_be_cleared_by_write(make_port):
    servo = make_port("AX-12A").line.servos[1]
    servo.write("lock", 1)
    refused = servo.write("id", 5), servo.write("lock", 0)
    servo.power_up()
    assert None not in refused
    assert servo.write("id", 5) is None


def test_bulk_read_is_answered_by_mx_in_order(make_port):
    port = make_port("MX-28", "MX-28")
    answers = ask(port, 254, 0x92, bytes.fromhex("00 02 02 00 01 01 2B"))
    assert answers == [(2, 0, b"\x1d\x00"), (1, 0, b"\x19")]


def test_bulk_read_is_not_answered_by_ax(make_port):
    assert ask(make_port("AX-12A"), 254, 0x92, bytes.fromhex("00 02 01 00")) == []


def test_sync_write_reaches_all_servos(make_port):
    port = make_port("AX-12A", "AX-12A")
    ask(port, 254, 0x83, bytes.fromhex("1E 02 01 10 02 02 20 02"))
    assert [port.line.servos[k].read("goal_position") for k in (1, 2)] == [0x210, 0x220]


def test_overload_sets_torque_limit_to_zero(make_port):
    servo = make_port("AX-12A").line.servos[1]
    servo.inject_alarm(0x20)
    servo.run_protections(0.01)
    assert (servo.alarm, servo.read("torque_limit")) == (0x20, 0)


def test_baud_rate_mismatch_of_ax_at_115200_is_tolerated(make_port):
    port = make_port("AX-12A")
    port.line.servos[1].write("baud_rate", 16)
    port.baudrate = 115_200
    assert len(ask(port, 1, 1)) == 1


class TestXSeriesWithProtocol1:
    def make(self, model="XL430-W250"):
        world = make_bench_world([BenchServo(1, model)], baud=1_000_000, protocol=1)
        port = SimulatedPort(Line(world, 1_000_000))
        port.timeout = 0.02
        return port

    def test_x_servo_in_protocol_1_mode_answers_protocol_1(self):
        assert ask(self.make(), 1, 2, b"\x00\x02") == [(1, 0, b"\x24\x04")]

    def test_x_servo_in_protocol_1_mode_ignores_protocol_2(self):
        port = self.make()
        port.write(bytes.fromhex("FFFFFD00010300 01194E".replace(" ", "")))
        assert port.read(20) == b""

    def test_model_without_protocol_1_mode_is_refused(self):
        with pytest.raises(SimulatorError, match="XL330-M288 does not speak"):
            self.make("XL330-M288")

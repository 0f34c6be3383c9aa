"""Each fault, as a client sees it."""

from __future__ import annotations

import pytest

from servosim.errors import FaultError, PortClosedError
from servosim.faults import Fault, read_faults

PING = bytes.fromhex("FFFF010201FB")
PONG = bytes.fromhex("FFFF010200FC")


def ping(port):
    port.write(PING)
    return port.read(6)


def run(port, seconds):
    port.clock.sleep_until(port.clock.now_s() + seconds)


def test_simulated_silence_lasts_for_configured_time(make_port):
    port = make_port("STS3215")
    port.line.faults.add(Fault("silent", id=1, at_s=0.05, for_s=0.05))
    received = []
    for _ in range(3):
        received.append(ping(port))
        run(port, 0.06)
    assert received == [PONG, b"", PONG]


def test_simulated_fault_of_one_servo_does_not_affect_others(make_port):
    port = make_port("STS3215")
    port.line.faults.add(Fault("silent", id=2))
    assert ping(port) == PONG


def test_late_reply_fault_delays_reply_into_next_request(make_port):
    port = make_port("STS3215", "STS3215")
    port.line.faults.add(Fault("late", id=1, delay_s=0.025, count=1))
    port.timeout = 0.02
    first = ping(port)
    port.clock.sleep_until(0.0245)
    port.write(bytes.fromhex("FFFF020201FA"))
    assert (first, port.read(12)) == (b"", bytes.fromhex("FFFF020200FB") + PONG)


@pytest.mark.parametrize(
    ("kind", "options", "expected"),
    [
        ("short", {"bytes": 4}, lambda received: received == PONG[:4]),
        ("checksum", {}, lambda received: received == PONG[:-1] + b"\x03"),
        ("flipped", {"bits": 1}, lambda received: len(received) == 6 and received != PONG),
        ("garbage", {"bytes": 3}, lambda received: received[3:] == PONG),
        ("truncated", {}, lambda received: PONG.startswith(received) and len(received) < 6),
        ("duplicated", {"delay_s": 0.001}, lambda received: received == PONG + PONG),
        ("lost", {}, lambda received: received == b""),
    ],
)
def test_reply_fault_changes_bytes_as_configured(make_port, kind, options, expected):
    port = make_port("STS3215")
    port.line.faults.add(Fault(kind, **options))
    port.write(PING)
    assert expected(port.read(64))


def test_simulated_fault_ends_after_configured_count(make_port):
    port = make_port("STS3215")
    port.line.faults.add(Fault("silent", count=2))
    assert [ping(port) for _ in range(3)] == [b"", b"", PONG]


def test_simulated_random_faults_repeat_with_same_seed(make_port):
    def losses():
        port = make_port("STS3215", seed=7)
        port.line.faults.add(Fault("silent", probability=0.5))
        return [ping(port) for _ in range(20)]

    first = losses()
    assert (first, {*first}) == (losses(), {b"", PONG})


def test_unplug_fault_closes_port_until_it_ends(make_port):
    port = make_port("STS3215")
    port.line.faults.add(Fault("unplug", at_s=0.01, for_s=0.05))
    run(port, 0.02)
    with pytest.raises(PortClosedError):
        port.write(PING)
    run(port, 0.06)
    assert ping(port) == PONG


def test_brownout_fault_switches_torque_off_and_clears_ram(make_port):
    port = make_port("STS3215")
    servo = port.line.servos[1]
    servo.write("acceleration", 30)
    servo.write("torque_enable", 1)
    port.line.faults.add(Fault("brownout", for_s=0.05))
    run(port, 0.01)
    during = ping(port), servo.drive.torque_on
    run(port, 0.06)
    after = ping(port), servo.read("acceleration"), servo.read("torque_enable")
    assert (during, after) == ((b"", False), (PONG, 0, 0))


def test_alarm_fault_sets_status_bits_until_it_ends(make_port):
    port = make_port("STS3215")
    port.line.faults.add(Fault("alarm", bits=0x04, for_s=0.05))
    run(port, 0.01)
    during = ping(port)
    run(port, 0.1)
    assert (during[4], ping(port)) == (0x04, PONG)


def test_overheating_fault_raises_alarm_and_switches_torque_off(make_port):
    port = make_port("STS3215")
    servo = port.line.servos[1]
    servo.write("torque_enable", 1)
    port.line.faults.add(Fault("hot", celsius=85))
    run(port, 0.1)
    assert (servo.read("status"), servo.drive.torque_on) == (0x04, False)


def test_stuck_fault_blocks_shaft_for_configured_time(make_port):
    port = make_port("STS3215")
    servo = port.line.servos[1]
    port.line.faults.add(Fault("stuck", for_s=0.5))
    run(port, 0.01)
    servo.write("torque_enable", 1)
    servo.write("goal_position", 2500)
    run(port, 0.4)
    during = servo.read("present_position")
    run(port, 1)
    assert (during, servo.read("present_position")) == (2048, pytest.approx(2500, abs=3))


def test_voltage_fault_changes_reading_and_raises_alarm(make_port):
    port = make_port("STS3215")
    servo = port.line.servos[1]
    port.line.faults.add(Fault("voltage", volts=3.5))
    run(port, 0.1)
    assert (servo.read("present_voltage"), servo.read("status")) == (35, 0x01)


def test_torque_lost_fault_does_not_clear_torque_register(make_port):
    port = make_port("XL430-W250")
    servo = port.line.servos[1]
    servo.write("torque_enable", 1)
    port.line.faults.add(Fault("torque_lost"))
    run(port, 0.01)
    assert (servo.read("torque_enable"), servo.drive.torque_on) == (1, False)


def test_slipping_fault_lets_joint_sag_under_load(configs):
    import servosim

    port = servosim.open_port(f"sim:{configs}/so101/arm.toml?pose=home")
    for servo in port.line.servos.values():
        servo.write("torque_enable", 1)
    run(port, 1)
    sound = port.line.servos[3].read("present_position")
    port.line.faults.add(Fault("slipping", id=3, grip=0.05))
    run(port, 1)
    assert abs(port.line.servos[3].read("present_position") - sound) > 100


def test_unknown_simulated_fault_error_lists_known_names(make_port):
    with pytest.raises(FaultError, match="no fault is named 'gremlin'; known: silent, late"):
        make_port("STS3215").line.faults.add(Fault("gremlin"))


class TestFiles:
    def test_simulated_faults_are_read_from_toml(self, tmp_path):
        path = tmp_path / "faults.toml"
        path.write_text('[[fault]]\nkind = "late"\nid = 3\nprobability = 0.02\ndelay_s = 0.1\n')
        assert read_faults(path) == [Fault("late", id=3, probability=0.02, delay_s=0.1)]

    def test_simulated_faults_are_read_from_json(self, tmp_path):
        path = tmp_path / "faults.json"
        path.write_text('[{"kind": "silent", "count": 2}]')
        assert read_faults(path) == [Fault("silent", count=2)]

    @pytest.mark.parametrize(
        ("text", "message"),
        [
            ("[[fault]]\nid = 3\n", "a fault needs a kind"),
            ('[[fault]]\nkind = "late"\ndelay = 3\n', "a fault has no key 'delay'"),
            ('[[fault]]\nkind = "late"\nid = "x"\n', "id = 'x' has the wrong kind"),
            ('[[fault]]\nkind = "short"\nbytes = 1.5\n', "bytes = 1.5 is not a whole number"),
            ('[[fault]]\nkind = "garbage"\nbytes = -1\n', "bytes = -1 is not between 0 and 4096"),
            ('[[fault]]\nkind = "alarm"\nbits = 256\n', "bits = 256 is not between 0 and 255"),
            ('[[fault]]\nkind = "late"\ndelay_s = nan\n', "delay_s = nan is not between"),
            ("nothing = 1\n", r"no \[\[fault\]\]"),
            ("[[[\n", "faults.toml"),
        ],
    )
    def test_invalid_simulator_faults_file_is_refused(self, tmp_path, text, message):
        path = tmp_path / "faults.toml"
        path.write_text(text)
        with pytest.raises(FaultError, match=message):
            read_faults(path)

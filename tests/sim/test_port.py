"""The in-process port has the interface of pyserial's Serial, in virtual time."""

from __future__ import annotations

import math

import pytest

import servosim
from servosim.errors import ArmFileError, PortClosedError, SimulatorError

PING = bytes.fromhex("FFFF010201FB")


def test_transmission_time_follows_from_baud_rate(make_port):
    port = make_port("STS3215")
    port.write(PING)
    port.read(6)
    assert port.clock.now_s() == pytest.approx(12 * 10e-6, abs=5e-6)


def test_simulated_reply_without_delay_is_available_at_once(make_port):
    port = make_port("STS3215", wire_time=False)
    port.write(PING)
    port.read(6)
    assert port.clock.now_s() < 10e-6


def test_simulated_port_read_without_reply_ends_at_time_out(make_port):
    port = make_port("STS3215")
    assert (port.read(6), port.clock.now_s()) == (b"", 0.02)


def test_simulated_port_read_returns_partial_data_at_time_out(make_port):
    port = make_port("STS3215")
    port.write(PING)
    assert port.read(60) == bytes.fromhex("FFFF010200FC")


def test_simulated_port_read_ends_if_no_reply_can_arrive(make_port):
    port = make_port("STS3215")
    port.timeout = None
    port.write(PING)
    assert len(port.read(60)) == 6


def test_simulated_port_read_with_zero_time_out_returns(make_port):
    port = make_port("STS3215")
    port.timeout = 0
    port.write(PING)
    assert port.read(6) == b""


def test_polling_input_buffer_advances_simulated_time(make_port):
    port = make_port("STS3215")
    port.write(PING)
    polls = 0
    while port.in_waiting < 6:
        polls += 1
    assert polls < 100


def test_simulated_port_flush_waits_for_last_byte(make_port):
    port = make_port("STS3215")
    port.write(PING)
    port.flush()
    assert port.clock.now_s() == pytest.approx(60e-6)


def test_reset_input_buffer_discards_received_bytes(make_port):
    port = make_port("STS3215")
    port.write(PING)
    port.clock.sleep_until(0.01)
    port.reset_input_buffer()
    assert port.in_waiting == 0


def test_closed_port_refuses_read(make_port):
    port = make_port("STS3215")
    port.close()
    with pytest.raises(PortClosedError):
        port.read(1)


def test_request_sent_during_reply_corrupts_reply(make_port):
    port = make_port("STS3215", "STS3215")
    port.write(PING)
    port.clock.sleep_until(80e-6)
    port.write(bytes.fromhex("FFFF020201FA"))
    assert bytes.fromhex("FFFF020200FB") not in port.read(64)


def test_same_simulator_seed_gives_same_replies(configs):
    def talk():
        port = servosim.open_port(f"sim:{configs}/so101/arm.toml?seed=3")
        port.timeout = 0.01
        port.write(bytes.fromhex("FFFFFE0682380201023C"))
        return port.read(64), port.clock.now_s()

    assert talk() == talk()


@pytest.mark.parametrize("name", ["so101", "koch", "open_manipulator_x", "px100", "vx300s"])
def test_simulated_arm_starts_at_pose_in_address(configs, name):
    path = configs / name / "arm.toml"
    port = servosim.open_port(f"sim:{path}?pose=home")
    arm = servosim.read_arm_file(path)
    for entry in arm.joints:
        servo = entry.servos[0]
        per_tick = servo.transmission.slope(0.0) * 2 * math.pi / 4096
        tick = servo.zero_tick + servo.sign * arm.poses["home"][entry.name] / per_tick
        assert port.line.servos[servo.id].read("present_position") == pytest.approx(tick, abs=1)


def test_simulated_limp_arm_falls(configs):
    port = servosim.open_port(f"sim:{configs}/so101/arm.toml?pose=home")
    before = port.line.servos[3].read("present_position")
    port.clock.sleep_until(3.0)
    assert abs(port.line.servos[3].read("present_position") - before) > 200


def test_two_simulated_servos_of_one_joint_turn_together(configs):
    port = servosim.open_port(f"sim:{configs}/vx300s/arm.toml?pose=home")
    for servo in port.line.servos.values():
        servo.write("torque_enable", 1)
    port.line.servos[2].write("profile_velocity", 50)
    port.line.servos[3].write("profile_velocity", 50)
    for id_ in (2, 3):
        port.line.servos[id_].write("goal_position", 1700)
    port.clock.sleep_until(2.0)
    ticks = [port.line.servos[id_].read("present_position") for id_ in (2, 3)]
    assert ticks == [pytest.approx(1700, abs=25), pytest.approx(ticks[0], abs=3)]


@pytest.mark.parametrize(("query", "comes_on"), [("", True), ("?goal_keeps_torque=1", False)])
def test_goal_keeps_torque_option_decides_if_goal_enables_torque(configs, query, comes_on):
    port = servosim.open_port(f"sim:{configs}/so101/arm.toml{query}")
    servo = port.line.servos[1]
    servo.write("goal_position", servo.read("present_position"))
    assert servo.drive.torque_on == comes_on


def test_backlash_option_applies_to_every_servo(configs):
    port = servosim.open_port(f"sim:{configs}/so101/arm.toml?backlash_deg=0.5")
    plays = {servo.motor.parameters.backlash_rad for servo in port.line.servos.values()}
    assert plays == {math.radians(0.5)}


@pytest.mark.parametrize("play", ["-1", "50", "nan", "much"])
def test_invalid_backlash_option_is_refused(configs, play):
    with pytest.raises(SimulatorError, match=r"backlash|number"):
        servosim.open_port(f"sim:{configs}/so101/arm.toml?backlash_deg={play}")


def test_unknown_simulator_pose_error_lists_known_poses(configs):
    with pytest.raises(ArmFileError, match=r"poses\.nowhere.*rest, home, zero"):
        servosim.open_port(f"sim:{configs}/so101/arm.toml?pose=nowhere")


def test_simulator_address_without_sim_prefix_is_refused():
    with pytest.raises(SimulatorError, match="sim:/path"):
        servosim.open_port("/dev/ttyUSB0")


@pytest.mark.parametrize(
    ("query", "message"),
    [
        ("seed=x", "seed=x is not a number"),
        ("colour=red", "has no option 'colour'; known: backlash_deg, board, cubes, echo"),
    ],
)
def test_invalid_simulator_address_option_is_refused(configs, query, message):
    with pytest.raises(SimulatorError, match=message):
        servosim.open_port(f"sim:{configs}/so101/arm.toml?{query}")


def test_simulator_address_options_set_echo_and_faults(configs, tmp_path):
    faults = tmp_path / "faults.toml"
    faults.write_text('[[fault]]\nkind = "silent"\nid = 1\ncount = 1\n')
    port = servosim.open_port(f"sim:{configs}/so101/arm.toml?echo=1&faults={faults}")
    port.timeout = 0.01
    port.write(PING)
    first = port.read(12)
    port.write(PING)
    assert (first, port.read(12)) == (PING, PING + bytes.fromhex("FFFF010200FC"))

"""The world of the servos: time, hands, rest, power."""

from __future__ import annotations

import math
import random

import pytest

import servosim
from servosim.errors import SimulatorError
from servosim.hands import CalibrationHands, RangeSweep
from servosim.joint import Hand, hold


def run(port, seconds):
    port.clock.sleep_until(port.clock.now_s() + seconds)


def test_simulated_world_is_idle_when_all_servos_rest(make_port):
    port = make_port("STS3215")
    run(port, 0.1)
    assert port.line.world.is_idle


def test_simulated_motor_reaches_goal_across_backlash(make_port):
    port = make_port("STS3215")
    servo, goals = port.line.servos[1], random.Random(1)
    servo.write("torque_enable", 1)
    servo.write("goal_speed", 1500)
    for _ in range(20):
        goal = goals.randrange(600, 3500)
        servo.write("goal_position", goal)
        run(port, 3.0)
        assert servo.read("present_position") == pytest.approx(goal, abs=10)
        assert servo.read("moving") == 0


def test_simulated_time_advances_in_idle_world(make_port):
    port = make_port("XL430-W250")
    run(port, 1.0)
    assert port.line.servos[1].read("realtime_tick") == 1000


def test_register_write_wakes_idle_simulated_world(make_port):
    port = make_port("STS3215")
    run(port, 0.1)
    port.line.servos[1].write("torque_enable", 1)
    assert not port.line.world.is_idle


def test_servo_holding_load_heats_up_in_idle_simulated_world(configs):
    port = servosim.open_port(f"sim:{configs}/so101/arm.toml?pose=home")
    for servo in port.line.servos.values():
        servo.write("torque_enable", 1)
    run(port, 60)
    assert port.line.world.is_idle
    assert port.line.servos[3].motor.temperature_c > 25.1


def test_scheduled_event_is_on_time_in_idle_simulated_world(make_port):
    port = make_port("STS3215")
    happened = []
    port.line.world.schedule(0.5, lambda: happened.append(port.line.world.time_s))
    run(port, 1.0)
    assert happened == [pytest.approx(0.5, abs=0.0011)]


def test_simulated_hand_moves_joint_of_limp_arm(configs):
    port = servosim.open_port(f"sim:{configs}/so101/arm.toml?pose=home")
    world = port.line.world
    world.grasp("elbow_flex", Hand(hold(0.3), limit=5.0))
    run(port, 1.0)
    assert world.joint("elbow_flex").position == pytest.approx(0.3, abs=0.01)


def test_simulated_hand_cannot_overcome_stronger_servo(make_port):
    port = make_port("STS3215")
    port.line.servos[1].write("torque_enable", 1)
    port.line.world.grasp("servo_1", Hand(hold(1.0), limit=0.5))
    run(port, 1.0)
    assert abs(port.line.world.joint("servo_1").position) < 0.1


def test_sim_hand_on_unknown_joint_error_lists_known_joints(make_port):
    with pytest.raises(SimulatorError, match="no joint is named 'knee'; known: servo_1"):
        make_port("STS3215").line.world.grasp("knee", Hand(hold(0.0)))


def test_simulated_hands_sweep_every_joint_of_limp_arm(configs):
    port = servosim.open_port(f"sim:{configs}/so101/arm.toml?pose=home&hand=sweep")
    world = port.line.world
    seen = []
    for _ in range(70):
        run(port, 0.1)
        seen.append([joint.position for joint in world.joints])
    for joint, low, high in zip(world.joints, *map_ends(seen), strict=True):
        lower, upper = world.limits[joint.name]
        assert (low, high) == (pytest.approx(lower, abs=0.1), pytest.approx(upper, abs=0.1))


def map_ends(rows):
    return [min(column) for column in zip(*rows, strict=True)], [
        max(column) for column in zip(*rows, strict=True)
    ]


def test_simulated_hand_sweeps_joint_only_after_torque_off(make_port):
    port = make_port("STS3215")
    servo, world = port.line.servos[1], port.line.world
    servo.write("torque_enable", 1)
    RangeSweep(world)
    run(port, 0.5)
    assert not world.hands
    servo.write("torque_enable", 0)
    run(port, 1.0)
    assert abs(world.joint("servo_1").position) > 0.3


def test_unknown_sim_hand_option_is_refused(configs):
    with pytest.raises(SimulatorError, match="sweep, calibrate"):
        servosim.open_port(f"sim:{configs}/so101/arm.toml?hand=wave")


def moved_by_hands(configs, joint, *spans_s):
    """Return the lowest and highest position of a joint in each of several time spans."""
    port = servosim.open_port(f"sim:{configs}/so101/arm.toml?pose=home&hand=calibrate")
    ranges = []
    for span_s in spans_s:
        seen = []
        for _ in range(round(span_s / 0.1)):
            run(port, 0.1)
            seen.append(port.line.world.joint(joint).position)
        ranges.append((min(seen), max(seen)))
    return ranges


@pytest.mark.full
def test_simulated_hands_hold_pose_then_show_joint_direction(configs):
    held, shown = moved_by_hands(configs, "wrist_flex", 8.0, 12.0)
    home, there = math.radians(60.0), math.radians(35.0)
    assert held == (pytest.approx(home, abs=0.01), pytest.approx(home, abs=0.01))
    assert shown == (
        pytest.approx(there, abs=0.05),
        pytest.approx(home, abs=0.02),
    )


@pytest.mark.full
def test_simulated_calibration_hands_restart_at_first_packet(configs):
    port = servosim.open_port(f"sim:{configs}/so101/arm.toml?pose=home&hand=calibrate")
    run(port, 26.0)
    wrist = port.line.world.joint("wrist_flex")
    swept = wrist.position
    port.write(bytes.fromhex("FFFF010201FB"))
    run(port, 3.0)
    assert wrist.position == pytest.approx(math.radians(60.0), abs=0.01)
    assert abs(swept - wrist.position) > 0.1


@pytest.mark.campaign
def test_simulated_calibration_hands_sweep_limp_joint(configs):
    _, (low, high) = moved_by_hands(configs, "shoulder_pan", 20.0, 8.0)
    assert (low, high) == (pytest.approx(-1.92, abs=0.08), pytest.approx(1.92, abs=0.08))


def test_mujoco_world_has_same_joint_limits(configs):
    pytest.importorskip("mujoco")
    port = servosim.open_port(f"sim:{configs}/so101/arm.toml?physics=1")
    plain = servosim.open_port(f"sim:{configs}/so101/arm.toml")
    assert port.line.world.limits["elbow_flex"] == pytest.approx(
        plain.line.world.limits["elbow_flex"]
    )


def test_simulated_calibration_hands_release_joint_at_torque_on(configs):
    port = servosim.open_port(f"sim:{configs}/so101/arm.toml?pose=home")
    CalibrationHands(port.line.world)
    port.line.servos[1].write("torque_enable", 1)
    run(port, 0.2)
    assert "shoulder_pan" not in port.line.world.hands


def test_simulated_servos_of_one_arm_differ_by_seed(configs):
    def frictions(seed):
        port = servosim.open_port(f"sim:{configs}/so101/arm.toml?seed={seed}")
        return [servo.motor.parameters.friction_nm for servo in port.line.world.servos]

    assert len(set(frictions(1))) == 6
    assert frictions(1) == frictions(1) != frictions(2)


@pytest.mark.parametrize(("supply_v", "model"), [(7.4, "STS3215"), (12.0, "STS3215-C018")])
def test_supply_voltage_of_arm_file_selects_servo_variant(configs, tmp_path, supply_v, model):
    text = (configs / "so101" / "arm.toml").read_text()
    urdf = configs / "so101" / "arm.urdf"
    file = tmp_path / "arm.toml"
    file.write_text(
        text.replace('"arm.urdf"', f'"{urdf}"').replace("supply_v = 7.4", f"supply_v = {supply_v}")
    )
    servo = servosim.open_port(f"sim:{file}").line.servos[1]
    assert (servo.table.model, servo.supply_v) == (model, supply_v)


def test_supply_voltage_without_servo_variant_is_refused(configs, tmp_path):
    text = (configs / "so101" / "arm.toml").read_text()
    urdf = configs / "so101" / "arm.urdf"
    file = tmp_path / "arm.toml"
    file.write_text(text.replace('"arm.urdf"', f'"{urdf}"').replace("= 7.4", "= 24"))
    with pytest.raises(SimulatorError, match="there is no STS3215 for 24 V"):
        servosim.open_port(f"sim:{file}")


def test_simulated_koch_servos_have_two_supply_voltages(configs):
    port = servosim.open_port(f"sim:{configs}/koch/arm.toml")
    run(port, 0.1)
    volts = [port.line.servos[k].read("present_input_voltage") for k in (1, 6)]
    assert volts == [120, 50]


def test_arm_simulated_in_mujoco_reaches_its_goal(configs):
    pytest.importorskip("mujoco")
    port = servosim.open_port(f"sim:{configs}/so101/arm.toml?pose=home&physics=1")
    for servo in port.line.servos.values():
        servo.write("torque_enable", 1)
    servo = port.line.servos[1]
    servo.write("goal_speed", 600)
    servo.write("goal_position", 2548)
    run(port, 3.0)
    assert servo.read("present_position") == pytest.approx(2548, abs=12)


def test_limp_arm_in_mujoco_comes_to_rest_on_floor(configs):
    pytest.importorskip("mujoco")
    port = servosim.open_port(f"sim:{configs}/so101/arm.toml?pose=home&physics=1")
    run(port, 6.0)
    speed = port.line.world.joint("shoulder_lift").velocity
    assert math.isclose(speed, 0.0, abs_tol=0.05)


def test_mujoco_world_of_limp_arm_becomes_idle(configs):
    port = servosim.open_port(f"sim:{configs}/so101/arm.toml?physics=1")
    port.clock.sleep_until(0.05)
    assert not port.line.world.is_idle
    port.clock.sleep_until(2.0)
    assert port.line.world.is_idle


def test_limp_joint_is_not_thrown_out_of_simulated_contact(configs):
    """A Koch arm stands in the table; only its shoulder, which can hardly lift it out, is limp."""
    port = servosim.open_port(f"sim:{configs}/koch/arm.toml?pose=home")
    world, run_s = port.line.world, 0.2
    for joint, position in zip(
        world.joints, (-0.0279, 0.6312, -1.4967, -0.2129, -1.4485, -0.0256), strict=True
    ):
        world.place(joint.name, position)
    for servo in world.servos:
        servo.write("torque_enable", servo.memory.get("id") != 2)
    fastest_rad_s = 0.0
    for _ in range(round(run_s / 0.001)):
        run(port, 0.001)
        fastest_rad_s = max(fastest_rad_s, abs(world.joint("shoulder_lift").velocity))
    assert fastest_rad_s < 3.0


@pytest.mark.parametrize(("arm", "rates"), [("so101", [0, 0, 1]), ("koch", [1, 1, 2])])
def test_box_has_unplugged_servos_of_which_three_are_odd(configs, arm, rates):
    port = servosim.open_port(f"sim:{configs}/{arm}/arm.toml?hand=box")
    servos = port.line.world.servos
    assert not any(servo.powered for servo in servos)
    for servo in servos:
        servo.power_up()
    assert [servo.read("id") for servo in servos] == [9, 1, 1, 1, 1, 1]
    assert [servo.read("baud_rate") for servo in servos[:3]] == rates
    version = "firmware_minor" if arm == "so101" else "firmware_version"
    assert servos[-2].read(version) - servos[-1].read(version) == 1

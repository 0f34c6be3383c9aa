"""An arm driven by LeRobot, judged by the simulated joints."""

import logging
import math

import numpy as np
import pytest

import ikservo
from ikservo.arm.setpoint_stream import open_stream
from servosim.faults import Fault
from tests.apps.remote.conftest import TIMEOUT_S, find_free_port, serve, until
from tests.arm.audit import Auditor
from tests.arm.simulated import line_of, registers, true_joints, true_tip_m

STAY = {"delta_x": 0.0, "delta_y": 0.0, "delta_z": 0.0, "gripper": 1.0}


# Gears with 1° of play and a load that changes sides: a stream of goals does not settle.
PLAY_M = 3e-3


@pytest.fixture
def connected(monkeypatch):
    """Return a function that connects a robot on a simulated arm; time passes as it sends."""
    from lerobot_robot_ikservo import IkservoRobot, IkservoRobotConfig

    monkeypatch.setattr(
        ikservo.Arm, "stream", lambda arm, speed: open_stream(arm, speed=speed, rate_hz=50)
    )
    robots = []

    def connect(port="sim:?pose=home", **options):
        robot = IkservoRobot(IkservoRobotConfig(id="a", port=port, **options))
        robot.connect()
        robots.append(robot)
        return robot

    yield connect
    for robot in robots:
        if robot.is_connected:
            robot.disconnect()


def arm_of(device):
    return device._connection.arm


def send(robot, action, frames):
    for _ in range(frames):
        robot.send_action(action)


def test_lerobot_joint_actions_are_degrees_and_gripper_percent(connected):
    robot = connected()
    arm = arm_of(robot)
    jaws = arm.model.gripper
    send(robot, {"shoulder_pan.pos": 10.0, "gripper.pos": 50.0}, 120)
    truth = true_joints(arm)
    assert math.degrees(truth["shoulder_pan"]) == pytest.approx(10.0, abs=0.5)
    assert truth["gripper"] == pytest.approx((jaws.open + jaws.closed) / 2, abs=0.05)
    seen = robot.get_observation()
    assert seen["shoulder_pan.pos"] == pytest.approx(10.0, abs=0.5)
    assert seen["gripper.pos"] == pytest.approx(50.0, abs=3.0)
    assert seen.keys() == robot.observation_features.keys()


def test_lerobot_observation_used_as_action_moves_nothing(connected):
    robot = connected(action="ee", observe_tip=True)
    seen = robot.get_observation()
    before = true_tip_m(arm_of(robot))
    action = {k: seen[k] for k in robot.action_features if k in seen}
    send(robot, {**action, "ee.gripper_pos": seen["gripper.pos"]}, 50)
    np.testing.assert_allclose(true_tip_m(arm_of(robot)), before, atol=PLAY_M)


def test_lerobot_pose_action_moves_tip_and_gripper(connected):
    robot = connected(action="ee", observe_tip=True)
    seen = robot.get_observation()
    action = {k: seen[k] for k in robot.action_features if k in seen}
    action |= {"ee.y": 0.03, "ee.z": seen["ee.z"] + 0.02, "ee.gripper_pos": 80.0}
    send(robot, action, 120)
    wanted = [action[f"ee.{axis}"] for axis in "xyz"]
    np.testing.assert_allclose(true_tip_m(arm_of(robot)), wanted, atol=2e-3)
    assert robot.get_observation()["gripper.pos"] == pytest.approx(80.0, abs=3.0)


@pytest.mark.sample(1)
@pytest.mark.parametrize("arm", ["so101", "wx250s"])
def test_ee_delta_actions_move_tip_and_keep_tool_angle(connected, arm):
    robot = connected(action="ee_delta", arm=arm, step_m=0.001, observe_tip=True)
    send(robot, STAY, 60)  # the first motion is slow
    before = robot.get_observation()
    start = true_tip_m(arm_of(robot)).copy()
    send(robot, {**STAY, "delta_z": 1.0}, 20)
    send(robot, STAY, 60)
    np.testing.assert_allclose(true_tip_m(arm_of(robot)) - start, [0, 0, 0.02], atol=PLAY_M)
    after = robot.get_observation()
    turned = [abs(after[k] - before[k]) for k in ("ee.wx", "ee.wy", "ee.wz")]
    assert max(turned) < math.radians(3.0)


def test_ee_delta_actions_move_remote_arm(connected, monkeypatch):
    monkeypatch.setattr("ikservo.apps.remote.client_connection._MAX_ROUND_TRIP_S", TIMEOUT_S)
    with serve(find_free_port()) as served:
        served.server.lease.timeout_s = TIMEOUT_S
        robot = connected(port=served.address, action="ee_delta", observe_tip=True)
        higher_m = robot.get_observation()["ee.z"] + 0.02

        def is_higher():
            robot.send_action({**STAY, "delta_z": 1.0})
            return robot.get_observation()["ee.z"] > higher_m

        until(is_higher)
        robot.disconnect()


@pytest.mark.sample(1)
@pytest.mark.parametrize(("step", "change"), [(2.0, 1), (0.0, -1), (-1.0, 0)])
def test_lerobot_gripper_steps_open_close_or_hold_gripper(connected, step, change):
    robot = connected(action="ee_delta")
    before = robot.get_observation()["gripper.pos"]
    send(robot, {**STAY, "gripper": step}, 5)
    send(robot, STAY, 60)
    after = robot.get_observation()["gripper.pos"]
    assert after - before == pytest.approx(change * 10.0, abs=2.0)


def test_ee_delta_action_out_of_reach_warns_once(connected, caplog):
    robot = connected(action="ee_delta", step_m=0.004)
    send(robot, {**STAY, "delta_x": 1.0}, 140)  # on the way back the guard may refuse a goal
    assert sum("out of reach" in line for line in caplog.messages) == 1
    furthest = true_tip_m(arm_of(robot))[0]
    send(robot, {**STAY, "delta_x": -1.0}, 15)
    send(robot, STAY, 40)
    assert true_tip_m(arm_of(robot))[0] < furthest - 0.03


def test_refused_lerobot_action_is_logged_once_and_next_runs(connected, caplog):
    robot = connected(action="ee_delta")
    send(robot, {**STAY, "delta_z": -1.0}, 200)
    assert any("the table" in line for line in caplog.messages)
    assert len(caplog.messages) == 1
    assert true_tip_m(arm_of(robot))[2] > 0.0
    send(robot, {**STAY, "delta_z": 1.0}, 60)
    assert true_tip_m(arm_of(robot))[2] > 0.05


def test_lerobot_goal_before_refused_one_is_still_reached(connected, caplog):
    robot = connected()
    send(robot, {"shoulder_pan.pos": 40.0}, 5)
    send(robot, {"shoulder_lift.pos": 90.0, "wrist_flex.pos": 90.0}, 2)
    assert any("the table" in line for line in caplog.messages)
    send(robot, {"gripper.pos": 50.0}, 120)
    assert math.degrees(true_joints(arm_of(robot))["shoulder_pan"]) == pytest.approx(40.0, abs=0.5)


def test_lerobot_joint_action_beyond_limit_is_clipped(connected, caplog):
    robot = connected()
    sent = robot.send_action({"elbow_flex.pos": 150.0})
    assert sent["elbow_flex.pos"] == pytest.approx(96.8, abs=0.2)
    assert "Limited to this arm's range: elbow_flex." in caplog.messages
    assert {record.levelno for record in caplog.records} == {logging.WARNING}


def test_lerobot_action_jump_is_followed_within_arm_limits(connected):
    robot = connected(speed="fast")
    auditor = Auditor(arm_of(robot))
    send(robot, {"shoulder_pan.pos": 0.0}, 5)
    send(robot, {"shoulder_pan.pos": 60.0}, 60)
    assert math.degrees(true_joints(arm_of(robot))["shoulder_pan"]) > 30.0
    assert auditor.faults() == []


def test_lerobot_actions_after_stop_are_ignored_with_one_message(connected, caplog):
    robot = connected()
    send(robot, {"shoulder_pan.pos": 5.0}, 20)
    arm_of(robot).stop("a person came near")
    send(robot, {"shoulder_pan.pos": 40.0}, 60)
    assert math.degrees(true_joints(arm_of(robot))["shoulder_pan"]) < 10.0
    robot.get_observation()
    lines = [line for line in caplog.messages if "actions are ignored" in line]
    assert len(lines) == 1
    assert "a person came near" in lines[0]


@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_lerobot_action_with_nan_or_infinity_moves_nothing(connected, caplog, value):
    robot = connected()
    before = true_joints(arm_of(robot))
    send(robot, {"shoulder_pan.pos": value}, 3)
    assert "not numbers" in caplog.text
    assert true_joints(arm_of(robot))["shoulder_pan"] == pytest.approx(before["shoulder_pan"])


@pytest.mark.parametrize("action", ["ee", "ee_delta"])
def test_lerobot_ee_modes_accept_joint_positions(connected, action):
    robot = connected(action=action)
    start = robot.get_observation()
    send(robot, {**start, "shoulder_pan.pos": 40.0}, 120)
    away = robot.get_observation()["shoulder_pan.pos"]
    send(robot, start, 120)
    back = robot.get_observation()["shoulder_pan.pos"]
    assert (away, back) == (pytest.approx(40.0, abs=0.5), pytest.approx(0.0, abs=0.5))


def test_lerobot_ee_pose_has_priority_over_joint_positions(connected):
    robot = connected(action="ee", observe_tip=True)
    seen = robot.get_observation()
    send(robot, {**seen, "shoulder_pan.pos": 40.0, "ee.gripper_pos": seen["gripper.pos"]}, 60)
    assert robot.get_observation()["shoulder_pan.pos"] == pytest.approx(0.0, abs=0.5)


def test_wrong_lerobot_action_type_error_names_its_option(connected):
    robot = connected(action="joint")
    with pytest.raises(ValueError, match="action=ee_delta"):
        robot.send_action(STAY)


def test_lerobot_disconnect_keeps_torque_on(connected):
    robot = connected()
    send(robot, {"shoulder_lift.pos": 0.0}, 100)
    arm, before = arm_of(robot), true_joints(arm_of(robot))
    robot.disconnect()
    world = line_of(arm).world
    world.advance_to(world.time_s + 2.0)
    assert all(registers(arm, "torque_enable").values())
    after = true_joints(arm)
    assert all(abs(after[name] - before[name]) < 0.02 for name in before)


def test_lerobot_on_exit_relax_lowers_arm_before_torque_off(connected):
    robot = connected(on_exit="relax")
    send(robot, {"shoulder_pan.pos": 5.0}, 20)
    arm = arm_of(robot)
    robot.disconnect()
    assert not any(registers(arm, "torque_enable").values())
    rest, at = arm.model.pose("rest"), true_joints(arm)
    assert at["shoulder_lift"] == pytest.approx(rest["shoulder_lift"], abs=0.1)


def test_lerobot_connect_moves_nothing_and_keeps_torque_off(connected):
    robot = connected(port="sim")
    assert robot.is_connected
    assert robot.is_calibrated
    assert not any(registers(arm_of(robot), "torque_enable").values())


def test_unplugged_port_raises_port_lost_error(connected):
    robot = connected()
    send(robot, {"shoulder_pan.pos": 5.0}, 5)
    line = line_of(arm_of(robot))
    line.faults.add(Fault("unplug", at_s=line.world.time_s + 0.1))
    with pytest.raises(ikservo.PortLostError):
        send(robot, {"shoulder_pan.pos": 10.0}, 50)


def test_second_lerobot_connect_is_refused(connected):
    from lerobot.utils.errors import DeviceAlreadyConnectedError

    robot = connected()
    with pytest.raises(DeviceAlreadyConnectedError):
        robot.connect()


class Camera:
    """The part of a LeRobot camera that a robot uses."""

    height, width = 4, 6

    def __init__(self):
        self.events = []

    def make(self):
        return self

    def connect(self):
        self.events.append("connect")

    def disconnect(self):
        self.events.append("disconnect")

    def async_read(self):
        return np.zeros((4, 6, 3), np.uint8)


def test_lerobot_cameras_are_opened_and_closed_with_robot(connected):
    camera = Camera()
    robot = connected(cameras={"wrist": camera})
    assert robot.observation_features["wrist"] == (4, 6, 3)
    assert robot.get_observation()["wrist"].shape == (4, 6, 3)
    robot.disconnect()
    assert camera.events == ["connect", "disconnect"]

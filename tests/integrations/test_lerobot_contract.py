"""Robot and teleoperators of the plug-in have the interface that LeRobot's commands use."""

import inspect
import tomllib
from pathlib import Path

import pytest

from ikservo import load_model

ROOT = Path(__file__).parents[2]
POSE = {"ee.x", "ee.y", "ee.z", "ee.wx", "ee.wy", "ee.wz"}


@pytest.fixture
def plugin():
    import lerobot_robot_ikservo

    return lerobot_robot_ikservo


def abstract_members(base):
    return {name: getattr(base, name) for name in base.__abstractmethods__}


@pytest.mark.parametrize(
    ("kind", "base"),
    [("IkservoRobot", "Robot"), ("IkservoLeader", "Teleoperator"), ("IkservoPage", "Teleoperator")],
)
def test_lerobot_plugin_classes_have_required_members(plugin, kind, base):
    import lerobot.robots
    import lerobot.teleoperators

    own = getattr(plugin, kind)
    parent = getattr(lerobot.robots, base, None) or getattr(lerobot.teleoperators, base)
    assert not own.__abstractmethods__
    for name, member in abstract_members(parent).items():
        ours = getattr(own, name)
        assert isinstance(ours, property) == isinstance(member, property), name
        if not isinstance(member, property):
            expected = list(inspect.signature(member).parameters)
            assert list(inspect.signature(ours).parameters) == expected, name


@pytest.mark.parametrize("kind", ["IkservoRobot", "IkservoLeader", "IkservoPage"])
def test_lerobot_finds_plugin_class_by_config_name(plugin, kind):
    config = getattr(plugin, f"{kind}Config")
    module = config.__module__.rpartition(".")[0]
    assert module == "lerobot_robot_ikservo"
    assert getattr(plugin, kind).config_class is config
    assert getattr(plugin, kind).name == config.type


def test_distribution_name_has_prefix_required_by_lerobot():
    text = (ROOT / "integrations/lerobot/pyproject.toml").read_text("utf-8")
    assert tomllib.loads(text)["project"]["name"] == "lerobot_robot_ikservo"


@pytest.mark.parametrize("arm", ["so101", "wx250s", "planar2"])
@pytest.mark.parametrize("action", ["joint", "ee", "ee_delta"])
def test_lerobot_robot_features_are_known_before_connecting(plugin, arm, action):
    robot = plugin.IkservoRobot(
        plugin.IkservoRobotConfig(id="a", arm=arm, port="sim", action=action)
    )
    model = load_model(arm)
    joints = {f"{joint.name}.pos" for joint in model.joints}
    assert set(robot.observation_features) == joints
    gripper = model.gripper is not None
    expected = {
        "joint": joints,
        "ee": POSE | ({"ee.gripper_pos"} if gripper else set()),
        "ee_delta": {"delta_x", "delta_y", "delta_z"} | ({"gripper"} if gripper else set()),
    }
    assert set(robot.action_features) == expected[action]
    assert not robot.is_connected


def test_lerobot_observation_contains_tip_pose_on_request(plugin):
    config = plugin.IkservoRobotConfig(id="a", port="sim", observe_tip=True)
    joints = plugin.IkservoRobot(plugin.IkservoRobotConfig(id="a", port="sim"))
    features = plugin.IkservoRobot(config).observation_features
    assert set(features) == set(joints.observation_features) | POSE


@pytest.mark.parametrize("arm", ["so101", "wx250s", "planar2"])
def test_lerobot_motors_are_joints_in_observation_order(plugin, arm):
    robot = plugin.IkservoRobot(plugin.IkservoRobotConfig(id="a", arm=arm, port="sim"))
    assert [f"{name}.pos" for name in robot.bus.motors] == list(robot.observation_features)
    assert [motor.id for motor in robot.bus.motors.values()] == [
        joint.servo.id for joint in load_model(arm).joints
    ]


def test_unknown_lerobot_action_type_error_lists_known_types(plugin):
    with pytest.raises(ValueError, match="joint, ee, ee_delta"):
        plugin.IkservoRobotConfig(action="tip")


def test_unconnected_lerobot_device_raises_not_connected_error(plugin):
    from lerobot.utils.errors import DeviceNotConnectedError

    robot = plugin.IkservoRobot(plugin.IkservoRobotConfig(id="a", port="sim"))
    leader = plugin.IkservoLeader(plugin.IkservoLeaderConfig(id="a", port="sim"))
    page = plugin.IkservoPage(plugin.IkservoPageConfig(id="a"))
    for call in (robot.get_observation, robot.disconnect, leader.get_action, page.get_action):
        with pytest.raises(DeviceNotConnectedError, match="not connected"):
            call()

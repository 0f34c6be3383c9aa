"""Leader arm and page as teleoperators, and the calibration of both."""

import json
import math
import sys

import pytest

import ikservo
from tests.arm.simulated import line_of
from tests.calibration.lerobot_files import lerobot_text
from tests.calibration.mounted_arms import make_mounted_arm


@pytest.fixture
def plugin():
    import lerobot_robot_ikservo

    return lerobot_robot_ikservo


def test_lerobot_leader_action_is_its_measured_joints(plugin):
    leader = plugin.IkservoLeader(plugin.IkservoLeaderConfig(id="a", port="sim:?pose=home"))
    leader.connect()
    line_of(leader._connection.arm).world.place("wrist_roll", math.radians(25.0))
    action = leader.get_action()
    leader.disconnect()
    assert action.keys() == leader.action_features.keys()
    assert action["wrist_roll.pos"] == pytest.approx(25.0, abs=0.5)
    assert not leader.is_connected


def test_lerobot_leader_with_torque_on_gives_warning(plugin, caplog):
    leader = plugin.IkservoLeader(plugin.IkservoLeaderConfig(id="a", port="sim:?pose=home"))
    opened = ikservo.open_arm

    def open_enabled(*args):
        arm = opened(*args)
        arm.enable()
        return arm

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(ikservo, "open_arm", open_enabled)
        leader.connect()
    leader.disconnect()
    assert "ikservo relax" in caplog.text


def test_lerobot_page_teleoperator_returns_joints_of_its_arm(plugin, caplog):
    page = plugin.IkservoPage(plugin.IkservoPageConfig(id="a", http_port=0))
    page.connect()
    try:
        assert page.url in caplog.text
        action = page.get_action()
        assert action.keys() == page.action_features.keys()
        assert action["wrist_flex.pos"] == pytest.approx(60.0, abs=3.0)
    finally:
        page.disconnect()
    assert not page.is_connected


def test_lerobot_page_teleoperator_refuses_unknown_pose(plugin):
    with pytest.raises(ikservo.UnknownNameError, match="home"):
        plugin.IkservoPage(plugin.IkservoPageConfig(id="a", pose="hoem"))


@pytest.mark.parametrize(
    ("options", "words"),
    [
        ({}, "calibrate so101 --port /dev/ttyX"),
        ({"assume_yes": True}, "calibrate so101 --port /dev/ttyX --yes"),
        ({"lerobot_calibration": "black"}, "import lerobot black --arm so101 --port /dev/ttyX"),
    ],
)
def test_lerobot_calibrate_runs_calibration_or_import(plugin, options, words):
    from lerobot_robot_ikservo.calibration import calibration_command

    config = plugin.IkservoRobotConfig(port="/dev/ttyX", **options)
    assert calibration_command(config) == [sys.executable, "-m", "ikservo", *words.split()]


def test_failed_lerobot_calibration_raises_calibration_error(plugin, monkeypatch):
    from lerobot_robot_ikservo import calibration

    robot = plugin.IkservoRobot(plugin.IkservoRobotConfig(id="a", port="sim"))
    robot.connect()
    monkeypatch.setattr(calibration, "calibration_command", lambda _: [sys.executable, "-c", "1/0"])
    monkeypatch.setattr(robot.config, "port", "/dev/ttyX")
    with pytest.raises(ikservo.CalibrationError, match="exit code 1"):
        robot.calibrate()


def test_lerobot_calibrate_writes_to_lerobot_folder(plugin, monkeypatch, folders):
    mounted = make_mounted_arm("so101", 21, spoiled=False)

    def open_transport(port, baud_rate):
        mounted.port.is_open = True
        return mounted.port

    monkeypatch.setattr("ikservo.hardware.port.open_transport", open_transport)
    robot = plugin.IkservoRobot(plugin.IkservoRobotConfig(id="black", port="/dev/ttyBENCH"))
    robot.connect(calibrate=False)
    assert not robot.is_calibrated
    monkeypatch.setattr(
        "lerobot_robot_ikservo.arm_connection.calibrate_arm",
        lambda _: calibrate_in_process(mounted, folders),
    )
    robot.calibrate()
    assert robot.is_calibrated
    written = json.loads((folders / "lerobot" / "robots" / "ikservo" / "black.json").read_text())
    assert written == json.loads(lerobot_text(mounted))
    assert robot.calibration == written
    robot.disconnect()


def calibrate_in_process(mounted, folder):
    """Import LeRobot's file of the arm like the command, by a scripted operator."""
    from ikservo.cli.entry_point import main
    from tests.calibration.scripted_operator import schedule_operator

    path = folder / "lerobots.json"
    path.write_text(lerobot_text(mounted))
    with mounted.open_limp() as limp_arm:
        schedule_operator(mounted, limp_arm.make_subjects("home"))
    words = f"import lerobot {path} --arm so101 --port /dev/ttyBENCH --pose home --margin 0.3 --yes"
    assert main(words.split()) == 0
    mounted.world.hands.clear()

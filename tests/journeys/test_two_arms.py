"""Two arms, in a terminal: one is moved by hand, the other follows."""

import sys
import time

import pytest

from tests.journeys.simulator_process import run_simulator
from tests.journeys.terminal import Terminal

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="Windows has no ptys"),
    pytest.mark.campaign,
    pytest.mark.timeout(300),
]


JOINTS = ("shoulder_pan", "elbow_flex", "wrist_flex")


@pytest.fixture(params=[80, 120])
def terminal(request, tmp_path):
    return Terminal(request.param, {"IKSERVO_HOME": str(tmp_path / "home")})


def test_follower_arm_reaches_joint_positions_of_leader(terminal, tmp_path):
    with (
        run_simulator(tmp_path / "leader", "so101", "--pose", "home", "--physics") as leader,
        run_simulator(tmp_path / "follower", "so101", "--pose", "home", "--physics") as follower,
    ):
        hold_all(leader)
        command = ["follow", "so101", "--leader-port", leader.port, "--arm", "so101"]
        with terminal.running(*command, "--port", follower.port, "--duration", "20") as program:
            program.wait_for("follows")
            leader.move_joint("shoulder_pan", 30.0)
            leader.move_joint("elbow_flex", 30.0)
            until(lambda: differences_deg(leader, follower) == [])
            ended = program.ended()
    assert ended.code == 0, ended.text
    assert not ended.long


def differences_deg(leader, follower):
    """Return the joints that differ by more than 3 degrees, and their differences."""
    led, followed = leader.joints_deg(), follower.joints_deg()
    found = {joint: followed[joint] - led[joint] for joint in JOINTS}
    return [(joint, by) for joint, by in found.items() if abs(by) > 3.0]


def until(condition, within_s=60.0):
    end_s = time.monotonic() + within_s
    while not condition():
        assert time.monotonic() < end_s, "it does not happen"
        time.sleep(0.05)


def hold_all(simulator):
    """Hold every joint by hand at its position."""
    for joint, deg in simulator.joints_deg().items():
        simulator.send_command("hand", joint=joint, deg=deg, force=20)

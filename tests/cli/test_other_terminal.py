"""Two terminals and one arm: one starts a motion; the other sees, stops and relaxes it."""

import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest

from tests.cli.test_over_a_pty import served

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no ptys")

SWAYING = """
import itertools, math, sys
import ikservo

def sway(arm):
    for cycle in itertools.count():
        if cycle == 50:
            print("moving", flush=True)
        yield {"shoulder_pan": 0.6 * math.sin(cycle / 200)}

with ikservo.open_arm("so101", port=sys.argv[1], collisions=False) as arm:
    arm.follow(sway(arm))
"""


@contextmanager
def swaying(port):
    """Let another program move the arm forever; return once it moves."""
    process = subprocess.Popen(
        [sys.executable, "-c", SWAYING, port],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    with process:
        assert process.stdout.readline() == "moving\n", process.stderr.read()
        try:
            yield process
        finally:
            process.kill()


@pytest.fixture(scope="module")
def port():
    with served("so101") as (name, _):
        yield name


@pytest.mark.full
def test_other_terminal_sees_and_stops_motion(run_cli, port):
    with swaying(port) as process:
        seen = run_cli(f"where --arm so101 --port {port} --json")
        stopped = run_cli("stop --json")
        _, result = process.communicate(timeout=30)
    assert seen.code == 0, seen.err
    assert all(joint["torque"] for joint in seen.json["joints"])
    assert stopped.code == 0, stopped.err
    (arm,) = stopped.json["arms"]
    assert (arm["arm"], arm["port"], arm["moving"]) == ("so101", port, True)
    assert len(arm["held"]) == 6
    assert "StoppedError: Stopped from another terminal; torque stays on." in result


@pytest.mark.full
def test_stop_command_works_after_program_was_killed(run_cli, port):
    with swaying(port) as process:
        process.send_signal(signal.SIGKILL)
        process.wait(timeout=30)
    stopped = run_cli(f"stop --arm so101 --port {port}")
    assert stopped.code == 0, stopped.err
    assert stopped.out.splitlines() == [
        f"so101 on {port} was not moving",
        "torque on   shoulder_pan, shoulder_lift, elbow_flex, wrist_flex, wrist_roll, gripper",
    ]

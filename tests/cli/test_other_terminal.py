"""Two terminals and one arm: what one starts, the other sees, stops and releases."""

import json
import signal
import subprocess
import sys
from contextlib import contextmanager

import pytest

from tests.cli.test_over_a_pty import run, served

pytestmark = pytest.mark.skipif(sys.platform == "win32", reason="Windows has no ptys")

SWAYING = """
import itertools, math, sys
import ikservo

def sway(arm):
    for beat in itertools.count():
        if beat == 50:
            print("moving", flush=True)
        yield {"shoulder_pan": 0.6 * math.sin(beat / 200)}

with ikservo.open_arm("so101", port=sys.argv[1], collisions=False) as arm:
    arm.follow(sway(arm))
"""


@contextmanager
def swaying(port):
    """Let another program move the arm for ever; it is under way by the time we go on."""
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


def test_a_motion_is_seen_and_stopped_from_another_terminal():
    with served("so101") as (port, _), swaying(port) as process:
        seen = run("where", "--arm", "so101", "--port", port, "--json")
        stopped = run("stop", "--json")
        _, said = process.communicate(timeout=30)
    assert seen.returncode == 0, seen.stderr
    assert all(joint["torque"] for joint in json.loads(seen.stdout)["joints"])
    assert stopped.returncode == 0, stopped.stderr
    (arm,) = json.loads(stopped.stdout)["arms"]
    assert (arm["arm"], arm["port"], arm["moving"]) == ("so101", port, True)
    assert len(arm["held"]) == 6
    assert "StoppedError: Stopped from another terminal; the arm holds." in said


def test_after_a_program_was_killed_the_arm_is_stopped_all_the_same():
    with served("so101") as (port, _):
        with swaying(port) as process:
            process.send_signal(signal.SIGKILL)
            process.wait(timeout=30)
        stopped = run("stop", "--arm", "so101", "--port", port)
    assert stopped.returncode == 0, stopped.stderr
    assert stopped.stdout.splitlines() == [
        f"so101 on {port} stands",
        "held    shoulder_pan, shoulder_lift, elbow_flex, wrist_flex, wrist_roll, gripper",
    ]

"""A box of servos becomes an arm, in a terminal: from six servos as bought to a motion played back.

Each part continues with the user's files of the part before. The arm is 3D-printed: its links
differ from its description, and the printed tip errors are compared with the true tip.
"""

import json
import math
import re
import signal
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.journeys.printed_arm import PrintedArm
from tests.journeys.simulator_process import run_simulator
from tests.journeys.terminal import Terminal

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="Windows has no ptys"),
    pytest.mark.campaign,
    pytest.mark.timeout(600),
]

AS_BOUGHT = ("1:sts3215", "1:sts3215@115200", "7:sts3215@500000", "1:sts3215@38400",
             "3:sts3215@250000", "1:sts3215")  # fmt: skip
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
TARGET_M = (0.25, 0.05, 0.15)
TOUCHES = 15
BENT = ({"wrist_flex": 30, "wrist_roll": -60}, {"wrist_flex": 85, "wrist_roll": 0},
        {"wrist_flex": 55, "wrist_roll": 60})  # fmt: skip
POSTURES = 6


@pytest.fixture(params=[80, 120])
def terminal(request, tmp_path):
    return Terminal(request.param, {"IKSERVO_HOME": str(tmp_path / "home")})


def test_setup_gives_six_new_servos_their_ids(terminal, tmp_path):
    servos = [word for servo in AS_BOUGHT for word in ("--servo", servo)]
    with run_simulator(tmp_path / "bench", *servos) as bench:
        for place in range(1, 7):
            bench.send_command("disconnect", servo=place)
        with terminal.running("setup", "so101", "--port", bench.port) as program:
            for place, joint in enumerate(JOINTS, start=1):
                program.wait_for(f"{place} of 6")
                bench.send_command("connect", servo=place)
                if AS_BOUGHT[place - 1] != f"{place}:sts3215":
                    program.wait_for("[y/n]", within_s=90)
                    program.type("y\r")
                program.wait_for(f"✓ {joint}", within_s=60)
                bench.send_command("disconnect", servo=place)
            ended = program.ended()
        assert ended.code == 0, ended.text
        assert not ended.long
        for place in range(1, 7):
            bench.send_command("connect", servo=place)
        found = terminal.run("scan", bench.port)
    assert found.code == 0
    assert not found.long
    assert "1000000" in found.text.replace(" ", "").replace("_", "")
    ids = [servo["id"] for servo in bench_state(found)]
    assert ids == [1, 2, 3, 4, 5, 6], found.text


def test_new_arm_is_calibrated_moved_taught_and_replayed(terminal, tmp_path):
    wave, printed = tmp_path / "wave.jsonl", PrintedArm(tmp_path / "printed")
    with run_simulator(tmp_path / "hand", printed.path) as arm:
        calibrate(terminal, arm, printed)
        where = assert_good(terminal.run("where", "--arm", "so101", "--port", arm.port))
        assert "hand sweep" in " ".join(where.text.split())
    with run_simulator(tmp_path / "hand", printed.path, "--pose", "home") as arm:
        cancel_touch_off(terminal, arm)
        touch_off(terminal, arm, printed)
    with run_simulator(tmp_path / "hand", printed.path, "--physics") as arm:
        on = ("--arm", "so101", "--port", arm.port)
        move(terminal, on)
        assert math.dist(printed.tip_m(arm.joints_deg()), TARGET_M) < 0.003
        teach(terminal, arm, on)
        record(terminal, arm, on, wave)
        assert_good(terminal.run("replay", wave, *on, "--yes"))
        assert_good(terminal.run("relax", *on, "--yes"))
        assert not any(arm.torque())


def assert_good(ended):
    assert ended.code == 0, ended.text[-2000:]
    assert not ended.long
    return ended


def calibrate(terminal, arm, printed):
    """Follow the instructions on the screen: pose, directions, sweep, review, save."""
    arm.move_joints(printed.held_deg)
    with terminal.running("calibrate", "so101", "--port", arm.port) as program:
        program.wait_for("The arm is still; continue.")
        program.type("\r")
        program.wait_for(f"Move {JOINTS[0]}")
        for joint, following in zip(JOINTS, (*JOINTS[1:], "every joint"), strict=True):
            arm.move_joint(joint, printed.shown_deg()[joint])
            program.wait_for(f"Move {following}")
            arm.move_joint(joint, printed.held_deg[joint])
        for ends_deg in printed.ends_deg():
            arm.move_joints(ends_deg, speed=1.5)
        program.wait_until(lambda lines: sum(line.endswith("✓") for line in lines) == len(JOINTS))
        program.type("\r")
        program.wait_for("Save to")
        program.wait_for("[y/n]")
        program.type("y\r")
        program.wait_for("into the servos as well? [y/n]")
        program.type("n\r")
        ended = assert_good(program.ended())
    assert "Saved to" in ended.text


def cancel_touch_off(terminal, arm):
    """Touch one cross, then cancel."""
    (filed,) = arms_folder(terminal).glob("*.toml")
    before = filed.read_bytes()
    with terminal.running("calibrate", "so101", "--touch", "--port", arm.port) as program:
        program.wait_for("Point 1 of 20")
        arm.move_tip(requested_point_m(program))
        touch(program)
        program.wait_for("Ctrl-C stop")
        program.type("\x03")
        ended = program.ended()
    assert ended.code == -signal.SIGINT, ended.text
    assert "Stopped: nothing was saved; torque is off." in ended.text
    assert not ended.long
    assert filed.read_bytes() == before


def touch_off(terminal, arm, printed):
    """Touch fifteen points with the wrist bent in turn; the printed tip errors must be true."""
    postures = printed.postures_deg(POSTURES)
    before_m = tip_errors_m(terminal, arm, printed, postures)
    words = ["calibrate", "so101", "--touch", "--block-height", "40mm", "--port", arm.port]
    with terminal.running(*words) as program:
        program.wait_for("Point 1 of 20")
        gaps_m = touch_all(program, arm, printed)
        program.type("a")
        program.wait_for("Save this? [y/n]")
        program.type("y\r")
        ended = assert_good(program.ended())
    assert "Saved to" in ended.text
    after_m = tip_errors_m(terminal, arm, printed, postures)
    printed_before_m, printed_after_m, median_m, max_m = printed_tip_errors_m(ended)
    assert printed_before_m == pytest.approx(rms(gaps_m), rel=0.15)
    assert rms(before_m) > 0.005
    assert rms(after_m) < 0.0015
    assert rms(after_m) < 2.0 * max(printed_after_m, median_m)
    assert max(after_m) < 2.0 * max_m


def touch_all(program, arm, printed):
    """Touch the requested points, skip one, undo one; return the apparent error of each [m]."""
    gaps_m = []
    for place in range(TOUCHES):
        point_m = requested_point_m(program)
        if place == 2:
            program.type("s")
            point_m = requested_point_m(program)
        if place == 3:
            program.type("a")
            program.wait_for("Too few touches: 3; at least 5")
        arm.move_joints(BENT[place % len(BENT)])
        arm.move_tip(point_m + printed.touch_error_m())
        touch(program)
        if place == 5:
            program.type("u")
            program.wait_for("Point 6 of 19")
            touch(program)
        gaps_m.append(math.dist(printed.believed_tip_m(arm.joints_deg()), point_m))
    return gaps_m


def requested_point_m(program):
    """Return the point that the screen requests (3,) [m]."""
    return np.array([float(x) for x in re.findall(r"[-\d.]+", program.wait_for("at (#, #, #) m"))])


def touch(program):
    """Press Enter, and again as long as the arm is reported to move."""
    shown = "moving"
    while "moving" in shown:
        program.type("\r")
        shown = program.wait_for_any("still moving", "Point # of #", "points touched")


def tip_errors_m(terminal, arm, printed, postures_deg):
    """Return the distances (n,) of the true tip from that of `where`, postures held by hand."""
    errors_m = []
    for posture_deg in postures_deg:
        arm.move_joints(posture_deg)
        where = terminal.run("where", "--arm", "so101", "--port", arm.port, "--json")
        assert where.code == 0, where.text
        state = json.loads(next(line for line in where.text.splitlines() if line.startswith("{")))
        errors_m.append(math.dist(state["tip_m"], printed.tip_m(arm.joints_deg())))
    return errors_m


def printed_tip_errors_m(ended):
    """Return the printed tip errors [m]: before, after, expected median and 95 %."""
    match = re.search(
        r"tip error: ([\d.]+) mm before, ([\d.]+) mm after \(15 touches.*"
        r"in the workspace: median ([\d.]+) mm, 95 % below ([\d.]+) mm",
        " ".join(ended.text.split()),
    )
    assert match, ended.text
    return [float(number) / 1000 for number in match.groups()]


def rms(errors_m):
    return math.sqrt(np.mean(np.square(errors_m)))


def arms_folder(terminal):
    return Path(terminal.env["IKSERVO_HOME"]) / "arms"


def move(terminal, on):
    """Move to a point; before the first motion, each joint shows its direction."""
    with terminal.running("move", *TARGET_M, *on) as program:
        program.wait_for("Move? [y/n]")
        program.type("y\r")
        program.wait_for("test motion first")
        while program.wait_for_any("[y/n]", "reached yes", within_s=90) == "[y/n]":
            program.type("y\r")
        assert_good(program.ended())


def teach(terminal, arm, on):
    """Move the limp arm to a pose by hand and name it; move there again."""
    with terminal.running("teach", "cup", *on) as program:
        program.wait_for("[y/n]")
        program.type("y\r")
        program.wait_for("press Enter")
        for joint, deg in arm.joints_deg().items():
            arm.send_command("hand", joint=joint, deg=deg, force=30)
        arm.move_joint("shoulder_pan", 20.0)
        program.type("\r")
        assert_good(program.ended())
    for joint in JOINTS:
        arm.release(joint)
    assert_good(terminal.run("pose", "cup", *on, "--yes"))
    assert arm.joints_deg()["shoulder_pan"] == pytest.approx(20.0, abs=3.0)


def record(terminal, arm, on, wave):
    """Relax, then record the limp arm while it is moved by hand."""
    assert_good(terminal.run("relax", *on, "--yes"))
    with terminal.running("record", wave, *on) as program:
        program.wait_for("Ctrl-C")
        arm.move_joint("shoulder_pan", 15.0)
        program.type("\x03")
        ended = program.ended()
    arm.release("shoulder_pan")
    assert_good(ended)
    assert wave.exists(), ended.text
    assert wave.stat().st_size > 1000


def bench_state(found):
    """Return the rows of a scan's table as ids."""
    rows = [line.split() for line in found.screen]
    return [{"id": int(row[0])} for row in rows if row and row[0].isdigit()]

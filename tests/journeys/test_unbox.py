"""A box of servos becomes an arm, in a terminal: from six servos as bought to a motion played back.

Each part begins where the part before has left the owner's files.
"""

import sys

import pytest

from tests.journeys.desk import served
from tests.journeys.terminal import Terminal

pytestmark = [
    pytest.mark.skipif(sys.platform == "win32", reason="Windows has no ptys"),
    pytest.mark.campaign,
    pytest.mark.timeout(600),
]

AS_BOUGHT = ("1:sts3215", "1:sts3215@115200", "7:sts3215@500000", "1:sts3215@38400",
             "3:sts3215@250000", "1:sts3215")  # fmt: skip
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")


@pytest.fixture(params=[80, 120])
def terminal(request, tmp_path):
    return Terminal(request.param, {"IKSERVO_HOME": str(tmp_path / "home")})


def test_six_servos_as_bought_get_their_ids_one_by_one(terminal, tmp_path):
    servos = [word for servo in AS_BOUGHT for word in ("--servo", servo)]
    with served(tmp_path / "bench", *servos) as bench:
        for place in range(1, 7):
            bench.do("disconnect", servo=place)
        with terminal.running("setup", "so101", "--port", bench.port) as program:
            for place, joint in enumerate(JOINTS, start=1):
                program.wait_for(f"{place} of 6")
                bench.do("connect", servo=place)
                if AS_BOUGHT[place - 1] != f"{place}:sts3215":
                    program.wait_for("[y/n]", within_s=90)
                    program.type("y\r")
                program.wait_for(f"✓ {joint}", within_s=60)
                bench.do("disconnect", servo=place)
            ended = program.ended()
        assert ended.code == 0, ended.text
        assert not ended.long
        for place in range(1, 7):
            bench.do("connect", servo=place)
        found = terminal.run("scan", bench.port)
    assert found.code == 0
    assert "1000000" in found.text.replace(" ", "").replace("_", "")
    ids = [servo["id"] for servo in bench_state(found)]
    assert ids == [1, 2, 3, 4, 5, 6], found.text


def test_the_new_arm_is_calibrated_moved_taught_and_played_back(terminal, tmp_path):
    wave = tmp_path / "wave.jsonl"
    with served(tmp_path / "hand", "so101", "--hand", "sweep") as arm:
        calibrate(terminal, arm)
        where = terminal.run("where", "--arm", "so101", "--port", arm.port)
        assert "hand sweep" in " ".join(where.text.split())
        assert not where.long
    with served(tmp_path / "hand", "so101", "--physics") as arm:
        on = ("--arm", "so101", "--port", arm.port)
        moved = terminal.run("move", "0.25", "0.05", "0.15", *on, typed=[("Move?", "y\r")])
        assert moved.code == 0, moved.text
        assert not moved.long
        teach(terminal, arm, on)
        record(terminal, arm, on, wave)
        played = terminal.run("replay", wave, *on, "--yes")
        assert played.code == 0, played.text
        relaxed = terminal.run("relax", *on, "--yes")
        assert relaxed.code == 0, relaxed.text
        assert not any(arm.torque())


def calibrate(terminal, arm):
    """Hold the conversation with the scripted hand: pose, sweep, review, save."""
    with terminal.running("calibrate", "so101", "--port", arm.port) as program:
        program.wait_for("press Enter")
        program.type("\r")
        program.wait_for("Move every joint", within_s=120)
        while program.text.split("Enter when")[-2].count("✓") < len(JOINTS):
            assert program.pump(), program.text[-2000:]
        program.type("\r")
        program.wait_for("Save to")
        program.type("y\r")
        program.wait_for("[y/n]")
        program.type("n\r")
        ended = program.ended()
    assert ended.code == 0, ended.text[-2000:]
    assert "Saved to" in ended.text


def teach(terminal, arm, on):
    """Lead the limp arm to a pose and give it a name; go there again."""
    with terminal.running("teach", "cup", *on) as program:
        program.wait_for("[y/n]")
        program.type("y\r")
        program.wait_for("press Enter")
        for joint, deg in arm.joints_deg().items():
            arm.do("hand", joint=joint, deg=deg, force=30)
        arm.lead("shoulder_pan", 20.0)
        program.type("\r")
        assert program.ended().code == 0, program.text
    for joint in JOINTS:
        arm.let_go(joint)
    gone = terminal.run("pose", "cup", *on, "--yes")
    assert gone.code == 0, gone.text
    assert arm.joints_deg()["shoulder_pan"] == pytest.approx(20.0, abs=3.0)


def record(terminal, arm, on, wave):
    """Relax, then record what a hand does with the limp arm."""
    assert terminal.run("relax", *on, "--yes").code == 0
    with terminal.running("record", wave, *on) as program:
        program.wait_for("Ctrl-C")
        arm.lead("shoulder_pan", 15.0)
        program.type("\x03")
        ended = program.ended()
    arm.let_go("shoulder_pan")
    assert ended.code in (0, 130), ended.text
    assert wave.exists(), ended.text
    assert wave.stat().st_size > 1000


def bench_state(found):
    """Return the rows of a scan's table as ids."""
    rows = [line.split() for line in found.screen]
    return [{"id": int(row[0])} for row in rows if row and row[0].isdigit()]

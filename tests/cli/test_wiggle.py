"""Only a person can see that two joints are exchanged, so each joint is shown."""

from itertools import combinations

import pytest

from ikservo.maintenance import direction_check
from ikservo.maintenance.direction_check import directions_confirmed
from tests.calibration.mounted_arms import load_model
from tests.cli.fixtures_mounted_arm import PORT, connect_arm, write_calibration
from tests.cli.fixtures_ports import run_arguments
from tests.journeys.fixtures_ports import place_arm

NAME = "planar2"
MOVE = f"move 0.18 0.05 0.05 --arm {NAME} --port {PORT} --no-collision"
# Every pair of six; in the suite those in which the first joints show it.
PAIRS = [
    pytest.param(pair, marks=() if pair in ((1, 2), (1, 6)) else pytest.mark.campaign)
    for pair in combinations(range(1, 7), 2)
]


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))


@pytest.fixture
def arm(monkeypatch):
    arm = connect_arm(monkeypatch, NAME, spoiled=False)
    write_calibration(arm)
    return arm


@pytest.fixture
def watcher(monkeypatch):
    """Return a function that lets a person watch an arm and report which joint moved."""

    def watch(arm):
        seen = {}
        original = direction_check.run_direction_check

        def wiggle(machine, motion):
            before = {j.name: j.position for j in arm.world.joints}
            most = dict.fromkeys(before, 0.0)

            def look():
                for joint in arm.world.joints:
                    moved = joint.position - before[joint.name]
                    most[joint.name] = max(most[joint.name], moved, key=abs)
                arm.world.schedule(arm.world.time_s + 0.05, look)

            arm.world.schedule(arm.world.time_s, look)
            original(machine, motion)
            moved = max(most, key=lambda name: abs(most[name]))
            seen[motion.joint] = moved == motion.joint and most[moved] * motion.travel > 0

        monkeypatch.setattr(direction_check, "run_direction_check", wiggle)
        monkeypatch.setattr("sys.stdin.isatty", lambda: True)
        monkeypatch.setattr("ikservo.cli.terminal.read_answer", answer(seen))
        return seen

    return watch


def answer(seen):
    def read_answer(prompt):
        right = seen[prompt.split()[1]] if prompt.startswith("Did") else True
        return "y" if right else "n"

    return read_answer


@pytest.mark.full
def test_joint_wiggle_moves_each_joint_once_after_calibration(arm, run_cli, watcher):
    watcher(arm)
    done = run_cli(MOVE)
    assert done.code == 0, done.err
    names = [joint.name for joint in load_model(NAME).joints]
    assert [line.split()[0] for line in done.err.splitlines() if "then back" in line] == names
    assert "then back" not in run_cli(MOVE).err


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize(
    "words", ["joints joint1=2 --no-collision", "pose home", "jog joint1 --duration 0.2"]
)
def test_joint_wiggle_precedes_joints_pose_and_jog_commands(arm, run_cli, watcher, words):
    watcher(arm)
    done = run_cli(f"{words} --arm {NAME} --port {PORT}")
    assert done.code == 0, done.err
    assert done.err.count("then back") == 2
    assert directions_confirmed(load_model(NAME), PORT)


@pytest.mark.campaign
def test_joint_wiggle_precedes_replay(arm, run_cli, watcher, tmp_path):
    tape = tmp_path / "wave.jsonl"
    assert run_cli(f"record {tape} --duration 0.3 --arm {NAME} --port {PORT}").code == 0
    watcher(arm)
    done = run_cli(f"replay {tape} --arm {NAME} --port {PORT}")
    assert done.code == 0, done.err
    assert done.err.count("then back") == 2


def test_joint_wiggle_is_skipped_for_uncalibrated_arm(monkeypatch, run_cli):
    connect_arm(monkeypatch, NAME, zero=2048, sign=1, spoiled=False)
    done = run_cli(f"joints joint1=5 --arm {NAME} --port {PORT} --no-collision --yes")
    assert "then back" not in done.err


@pytest.mark.full
def test_joint_wiggle_is_required_again_after_calibration(arm, run_cli):
    assert run_cli(f"{MOVE} --yes").code == 0
    assert directions_confirmed(load_model(NAME), PORT)
    arm.port.clock.sleep_until(arm.port.clock.now_s() + 0.01)  # the last goals arrive
    for servo in arm.line.servos.values():
        servo.write("torque_enable", 0)
    write_calibration(arm)  # the arm stands elsewhere by now
    assert not directions_confirmed(load_model(NAME), PORT)


def test_joint_wiggle_without_operator_refuses_motion(arm, run_cli):
    before = arm.true_position("joint1")
    done = run_cli(MOVE)
    assert (done.code, "--yes" in done.err) == (2, True)
    assert arm.true_position("joint1") == pytest.approx(before, abs=1e-3)


@pytest.mark.full
def test_joint_wiggle_can_be_switched_off(arm, run_cli):
    done = run_cli(f"{MOVE} --no-wiggle --yes")
    assert done.code == 0
    assert "then back" not in done.err


def test_joint_wiggle_is_not_done_in_dry_run(arm, run_cli):
    assert "then back" not in run_cli(f"{MOVE} --dry-run --yes").err


@pytest.mark.full
def test_joint_wiggle_names_jammed_joint(arm, run_cli):
    arm.line.servos[2].motor.stuck = True
    done = run_cli(f"calibrate {NAME} --port {PORT} --wiggle --yes")
    assert done.code in (6, 8)
    assert "joint2" in done.err


def swapped(monkeypatch, pair):
    """Mount an uncalibrated arm with the ids of two servos exchanged."""
    arm = connect_arm(monkeypatch, "so101", zero=2048, sign=1, spoiled=False)
    memories = [arm.line.servos[i].memory for i in pair]
    for memory, new in zip(memories, reversed(pair), strict=True):
        memory.put("id", new)
        memory.persist_value("id")
    arm.power_cycle()
    return arm


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("pair", PAIRS, ids=str)
def test_joint_wiggle_finds_swapped_servo_ids(monkeypatch, run_cli, watcher, pair):
    arm = swapped(monkeypatch, pair)
    watcher(arm)
    done = run_cli(f"calibrate so101 --port {PORT} --wiggle --uncalibrated")
    assert done.code == 6, done.err
    assert "does not move as the arm file says" in done.err
    assert not directions_confirmed(load_model("so101"), PORT)


@pytest.mark.full
def test_joint_wiggle_finds_mirrored_joint_sign(monkeypatch, run_cli, watcher):
    arm = connect_arm(monkeypatch, NAME, zero=2048, sign=-1, spoiled=False)
    watcher(arm)
    done = run_cli(f"calibrate {NAME} --port {PORT} --wiggle --uncalibrated")
    assert (done.code, "If the joint went the other way" in done.err) == (6, True)


@pytest.mark.full
def test_pose_command_lifts_tool_first_if_arm_rests_on_table(monkeypatch):
    bench = place_arm(monkeypatch, "so101", "rest, sunk", "real, calibrated")
    done = run_arguments(["pose", "home", "--arm", "so101", "--port", bench.port, "--yes"])
    assert done.code == 0, done.err
    assert "The arm rests on something, so elbow_flex moves so that the tool moves up" in done.err

"""Without a terminal for questions, a real arm moves only with --yes; a simulated one always."""

import pytest

from ikservo.model import arm_names
from tests.cli.fixtures_mounted_arm import PORT, connect_arm, write_calibration
from tests.cli.test_recover import overload

NAME = "planar2"
REAL = f"--arm {NAME} --port {PORT}"
MOTIONS = [
    f"move 0.18 0.05 0.05 {REAL} --no-collision",
    f"joints joint1=5 {REAL}",
    f"pose home {REAL}",
    f"jog joint1 --duration 200ms {REAL}",
    f"relax {REAL}",
    f"replay wave.jsonl {REAL}",
    f"calibrate {NAME} --wiggle --port {PORT}",
    f"recover --reboot {REAL}",
]


@pytest.fixture(autouse=True)
def no_terminal(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    monkeypatch.setattr("sys.stdin.isatty", lambda: False)
    monkeypatch.chdir(tmp_path)


@pytest.fixture
def arm(monkeypatch):
    arm = connect_arm(monkeypatch, NAME, spoiled=False)
    write_calibration(arm)
    return arm


@pytest.mark.parametrize("words", MOTIONS)
def test_real_arm_does_not_move_without_confirmation(run_cli, arm, words):
    if words.startswith("replay"):
        assert run_cli(f"record wave.jsonl --duration 100ms {REAL}").code == 0
    before = [joint.position for joint in arm.world.joints]
    result = run_cli(words)
    assert (result.code, "input is not a terminal" in result.err) == (2, True), result.err
    assert "--yes" in result.err
    assert [joint.position for joint in arm.world.joints] == pytest.approx(before, abs=1e-3)


def test_real_gripper_does_not_close_without_confirmation(run_cli, monkeypatch):
    write_calibration(connect_arm(monkeypatch, "so101", spoiled=False))
    result = run_cli(f"gripper close --arm so101 --port {PORT}")
    assert (result.code, "input is not a terminal" in result.err) == (2, True), result.err


@pytest.mark.full
def test_yes_option_moves_real_arm_without_question(run_cli, arm):
    result = run_cli(f"joints joint1=5 {REAL} --yes --no-wiggle --no-collision")
    assert result.code == 0, result.err


@pytest.mark.sample(1)
@pytest.mark.parametrize("words", ["joints joint1=5", "jog joint1 --duration 100ms", "pose home"])
def test_simulated_arm_does_not_need_confirmation(run_cli, words):
    assert run_cli(f"{words} --arm {NAME} --port sim:?pose=home").code == 0


def test_record_of_holding_arm_explains_how_to_free_it(run_cli, arm):
    for servo in arm.line.servos.values():
        servo.write("torque_enable", 1)
    result = run_cli(f"record wave.jsonl --duration 100ms {REAL}")
    assert result.code == 0
    assert "Torque is on, so the arm cannot be guided by hand." in result.err
    assert "To switch torque off: ikservo relax" in result.err


def test_record_of_limp_arm_does_not_mention_torque(run_cli, arm):
    assert "Torque" not in run_cli(f"record wave.jsonl --duration 100ms {REAL}").err


def test_record_relaxes_holding_arm_after_confirmation(run_cli, arm, monkeypatch):
    for servo in arm.line.servos.values():
        servo.write("torque_enable", 1)
    relaxed = []
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("ikservo.apps.teaching.record_command.confirm", lambda question: True)
    monkeypatch.setattr("ikservo.arm.Arm.relax", lambda machine: relaxed.append(machine.model))
    assert run_cli(f"record wave.jsonl --duration 100ms {REAL}").code == 0
    assert len(relaxed) == 1


@pytest.mark.parametrize("name", ["so101", "koch"])
def test_relax_warns_if_overload_would_stop_lowering(run_cli, monkeypatch, name):
    arm = connect_arm(monkeypatch, name, spoiled=False)
    write_calibration(arm)
    overload(arm.line.servos[2])
    result = run_cli(f"relax --arm {name} --port {PORT}")
    assert result.code == 2
    first, second, question = result.err.splitlines()[-4:-1]
    assert first.startswith("The arm cannot be lowered: shoulder_lift reports an alarm: overload")
    assert second == "Torque will be switched off in the present pose: support the arm."
    assert "input is not a terminal" in question


def test_pose_command_lists_poses_of_all_arms_without_a_port(run_cli, monkeypatch):
    monkeypatch.setattr("serial.tools.list_ports.comports", list)
    result = run_cli("pose")
    rows = dict(line.split(maxsplit=1) for line in result.out.splitlines()[1:])
    assert result.code == 0
    assert rows.keys() == set(arm_names())
    assert rows["so101"] == "rest, home, zero"
    listed = {arm["name"]: list(arm["poses"]) for arm in run_cli("pose --json").json["arms"]}
    assert listed["so101"] == ["rest", "home", "zero"]
    assert listed.keys() == rows.keys()


@pytest.mark.parametrize(
    ("hold", "says"), [("", "torque stays as it is"), (" --hold", "torque comes on")]
)
def test_teach_announces_torque_off_and_pose_to_be_replaced(
    run_cli, tmp_path, monkeypatch, hold, says
):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    words = f"teach cup --now --arm so101 --port sim{hold}"
    first, again = run_cli(words), run_cli(words)
    assert first.code == 0
    assert f'The present pose is saved as "cup"; {says}' in first.err.split("Saved pose")[0]
    assert "This replaces" not in first.err
    assert 'This replaces the pose "cup"' in again.err.split("Saved pose")[0]


def test_pose_command_lists_poses_of_one_arm_without_a_port(run_cli, monkeypatch):
    monkeypatch.setattr("serial.tools.list_ports.comports", list)
    result = run_cli("pose --arm so101")
    assert (result.code, result.out.split()) == (0, ["rest", "home", "zero"])

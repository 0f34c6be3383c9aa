"""Output and refusals of the commands besides `move` that move an arm."""

import json
import re

import pytest

import ikservo
from ikservo.arm import JointState
from ikservo.cli import main
from ikservo.cli.commands.where import heat_colour, limit_colour, position_bar, watch_arm
from ikservo.cli.entry_point import with_connection_options
from ikservo.errors import UnreachableError, format_point
from ikservo.model.arm_model import HealthLimits
from servosim.clock import VirtualClock

SIM = "--arm so101 --port sim:?pose=home"


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path / "home"))
    monkeypatch.chdir(tmp_path)
    return tmp_path


def test_stop_command_lists_torque_of_every_joint(run_cli):
    result = run_cli(f"stop {SIM}")
    assert result.code == 0
    first, second = result.out.splitlines()
    assert first.startswith("so101 on sim ")
    assert first.endswith("was not moving")
    assert second == (
        "torque off  shoulder_pan, shoulder_lift, elbow_flex, wrist_flex, wrist_roll, gripper"
    )


def test_stop_command_without_arm_needs_a_running_program(run_cli):
    result = run_cli("stop")
    assert result.code == 2
    assert result.err.startswith("None of your programs has an arm open, and no arm is served")
    assert "ikservo stop --arm" in result.err


def test_jog_ends_when_its_duration_is_up(run_cli):
    result = run_cli(f"jog shoulder_pan --speed -20 --duration 300ms {SIM} --json")
    assert result.code == 0
    assert result.json["schema"] == "ikservo/jog/1"
    assert result.json["ended"] == "time is up"
    assert -0.2 < result.json["measured_rad"]["shoulder_pan"] < -0.05


@pytest.mark.parametrize(("speed", "back"), [("-40", "--speed 40"), ("", "a negative --speed")])
def test_blocked_jog_error_says_how_to_jog_back(run_cli, speed, back):
    option = f"--speed {speed}" if speed else ""
    joint = "shoulder_lift" if speed else "elbow_flex"
    result = run_cli(f"jog {joint} {option} --duration 6 --arm so101 --port sim")
    assert f"Jog back with {back}." in result.err


@pytest.mark.parametrize("compiled", [True, False])
def test_jog_warns_once_if_solver_is_not_compiled(run_cli, monkeypatch, compiled):
    monkeypatch.setattr("ikservo.cli.open_and_confirm.is_compiled", lambda: compiled)
    result = run_cli(f"jog shoulder_pan --duration 100ms {SIM} --json")
    assert result.err.count("not compiled") == (not compiled)
    assert result.code == 0


@pytest.mark.parametrize(
    ("words", "found"),
    [
        ("jog shoulder_pan", "Cannot read keys: input is not a terminal."),
        ("jog shoulder_pan --duration 0", "not a time above 0"),
        ("jog shoulder_pan --duration 1 --speed 0", "The speed is 0."),
        ("jog shoulder_pan --duration 1 --speed 20mm", "is not an angle"),
        ("jog elbow --duration 1", "There is no joint or direction named 'elbow'."),
        ("gripper ajar", "There is no gripper motion named 'ajar'."),
        ("gripper 30mm", "The width is 0.03 m."),
        ("gripper close --force 2", "The force is 2."),
        ("teach cup", "Cannot wait for Enter, because input is not a terminal."),
        ("teach cup --float", "Cannot wait for Enter, because input is not a terminal."),
        ("teach cup --float --now", "--float and --now cannot be used together."),
        ("teach cup --for 2s --now", "--for can only be used with --float."),
        ("teach home --float --for 1s", "The name of the pose is home, a pose of the arm"),
        ("teach home --now", "The name of the pose is home, a pose of the arm file."),
        ("pose cupp", "There is no pose named 'cupp'."),
        ("record wave.jsonl", "Cannot wait for Ctrl-C, because input is not a terminal."),
        ("record no/wave.jsonl --duration 1", "no/wave.jsonl cannot be written"),
        ("replay wave.jsonl", "wave.jsonl: does not exist"),
        ("replay wave.jsonl --speed swift", "There is no speed named 'swift'."),
        ("follow so102", "There is no arm named 'so102'."),
    ],
)
def test_motion_commands_refuse_invalid_input_with_one_line(run_cli, words, found):
    result = run_cli(f"{words} {SIM}")
    assert result.code in (1, 2)
    assert found in result.err
    assert "Traceback" not in result.err


@pytest.mark.full
def test_gripper_command_reports_grasp_position_and_load(run_cli):
    result = run_cli(f"gripper close {SIM}")
    assert result.code == 0
    assert re.fullmatch(
        r"grasped   no\ngripper   -\d+\.\d°, load -?\d+ %\nreached   yes\nduration  \d\.\d\d s\n",
        result.out,
    )


@pytest.mark.full
def test_taught_pose_is_listed_and_can_be_reached(run_cli, home):
    taught = run_cli(f"teach cup --now {SIM} --json")
    assert taught.json["schema"] == "ikservo/teach/1"
    assert set(taught.json["joints_rad"]) == {
        "shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper"
    }  # fmt: skip
    assert run_cli(f"pose {SIM}").out == "rest\nhome\nzero\ncup\n"
    assert run_cli(f"pose cup {SIM}").code == 0


@pytest.mark.full
def test_recording_is_replayed_with_all_its_samples(run_cli, home):
    recorded = run_cli(f"record wave.jsonl --duration 200ms {SIM} --json")
    assert recorded.json["samples"] in (10, 11)
    planned = run_cli(f"replay wave.jsonl --dry-run {SIM} --json")
    assert planned.json["schema"] == "ikservo/replay-plan/1"
    replayed = run_cli(f"replay wave.jsonl {SIM} --json")
    assert replayed.code == 0, replayed.err
    assert replayed.json["samples"] == recorded.json["samples"]


def test_recording_is_not_overwritten_without_the_option(run_cli, home):
    (home / "wave.jsonl").write_text("precious")
    result = run_cli(f"record wave.jsonl --duration 1 {SIM}")
    assert result.err.startswith("File wave.jsonl exists; use --overwrite.")
    assert (home / "wave.jsonl").read_text() == "precious"


def test_truncated_recording_is_refused_with_line_number(run_cli, home):
    run_cli(f"record wave.jsonl --duration 200ms {SIM}")
    whole = (home / "wave.jsonl").read_text()
    (home / "wave.jsonl").write_text(whole[:-4])
    result = run_cli(f"replay wave.jsonl {SIM}")
    assert result.code == 2
    assert "line 11: is incomplete" in result.err or "line 12: is incomplete" in result.err


def test_follow_command_follows_another_arm(run_cli):
    result = run_cli(f"follow so101 --leader-port sim:?pose=home --duration 400ms {SIM} --json")
    assert result.code == 0, result.err
    assert result.json["ended"] == "end of the targets"
    assert result.json["setpoints"] > 10


def test_where_watch_json_prints_one_object_per_line(run_cli):
    result = run_cli(f"where --watch --count 3 --period 1ms {SIM} --json")
    rows = [json.loads(line) for line in result.out.splitlines()]
    assert [row["schema"] for row in rows] == ["ikservo/where/1"] * 3


def test_where_watch_waits_for_its_period(capsys):
    clock = VirtualClock()
    model = ikservo.load_model("so101")
    watch_arm(model, "sim", 3600.0, 3, uncalibrated=False, json=True, clock=clock)
    assert clock.now_s() == 7200.0
    assert len(capsys.readouterr().out.splitlines()) == 3


def test_where_watch_shows_joint_positions_between_limits(run_cli):
    result = run_cli(f"where --watch --count 1 {SIM}")
    assert "shoulder_pan       0.0°  -110.0°  ├" in result.out
    assert "temperature" not in result.out
    assert result.out.count("●") == 6


@pytest.mark.parametrize(
    ("position", "drawn"),
    [(-1.0, "├●────────┤"), (0.0, "├────●────┤"), (1.0, "├────────●┤"), (9.0, "├────────●┤")],
)
def test_position_bar_shows_joint_position_within_limits(position, drawn):
    assert position_bar(position, -1.0, 1.0, 9) == drawn


def test_position_bar_without_limits_marks_middle():
    assert position_bar(3.0, -float("inf"), float("inf"), 9) == "├────●────┤"


def test_misspelled_command_suggests_the_closest(run_cli):
    result = run_cli("mvoe 1 2 3")
    assert result.code == 2
    assert result.err == "No such command 'mvoe'. Did you mean move?\nTry: ikservo --help\n"


@pytest.mark.parametrize(
    ("hint", "whole"),
    [
        (
            "Switch torque off with: ikservo relax",
            "Switch torque off with: ikservo relax --arm a --port p",
        ),
        ("Try: ikservo move 0.2 -0.1 0.3", "Try: ikservo move 0.2 -0.1 0.3 --arm a --port p"),
        ("Its alarms: ikservo where --arm a", "Its alarms: ikservo where --arm a --port p"),
        ("Try: ikservo move --help", "Try: ikservo move --help"),
        (
            "Calibrate it: ikservo calibrate so101. Until then: ikservo joints, at most 10°",
            "Calibrate it: ikservo calibrate so101 --port p. "
            "Until then: ikservo joints --arm a --port p, at most 10°",
        ),
        ("New servos: ikservo setup ARM", "New servos: ikservo setup a --port p"),
        ("See: ikservo calibration diff", "See: ikservo calibration diff a --port p"),
        ("Give --yes.", "Give --yes."),
        ("", ""),
    ],
)
def test_suggested_command_includes_arm_and_port(hint, whole):
    assert with_connection_options(hint, ["move", "1", "2", "3", "--arm", "a", "--port=p"]) == whole


def test_unreachable_point_hint_is_working_command(run_cli):
    result = run_cli(f"move 0.9 0 0.1 {SIM}")
    words = result.err.strip().rpartition("Try: ikservo ")[2]
    assert words.endswith("--arm so101 --port 'sim:?pose=home'")
    assert main([*words.split()[:-2], "--port", "sim:?pose=home", "--dry-run"]) == 0


def test_shell_completion_offers_arms_and_poses(run_cli, monkeypatch):
    run_cli(f"teach cup --now {SIM}")
    from ikservo.cli.completion import complete_arms, complete_poses

    class Context:
        params = {"arm": "so101"}  # noqa: RUF012

    assert complete_arms("so") == ["so100", "so101"]
    assert complete_poses(Context(), "") == ["cup", "home", "rest", "zero"]
    Context.params = {"arm": "nonsense"}
    assert complete_poses(Context(), "") == []


@pytest.mark.parametrize("nothing", [-0.0, -1e-9, -0.0004])
def test_command_output_never_contains_minus_zero(nothing):
    assert format_point((nothing, 0.0, 0.0)) == "(0.000, 0.000, 0.000) m"
    assert ikservo.load_model("so101").joint("gripper").joint_map.format(nothing) == "0.0°"
    assert "-0.000" not in str(UnreachableError((nothing, 0, 0), (0, nothing, 0)))


def test_jog_command_moves_while_space_bar_is_held(run_cli, monkeypatch):
    from contextlib import contextmanager

    pressed = iter(["", " ", *[" ", "", ""] * 20])

    @contextmanager
    def keyboard():
        yield lambda: next(pressed, "")

    monkeypatch.setattr("ikservo.cli.commands.jog.read_keys", keyboard)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    result = run_cli(f"jog shoulder_pan --speed 20 {SIM} --json")
    assert result.code == 0, result.err
    assert result.json["ended"] == "key released"
    assert result.json["measured_rad"]["shoulder_pan"] > 0.2
    assert "Hold the space bar" in result.err


def test_teach_float_saves_pose_and_holds_at_enter_key(run_cli, monkeypatch):
    from contextlib import contextmanager

    pressed = iter([*[""] * 300, "\n"])

    @contextmanager
    def keyboard():
        yield lambda: next(pressed)

    monkeypatch.setattr("ikservo.apps.teaching.teach_command.read_keys", keyboard)
    monkeypatch.setattr("sys.stdin.isatty", lambda: True, raising=False)
    result = run_cli(f"teach cup --float {SIM} --json")
    assert result.code == 0, result.err
    assert next(pressed, None) is None
    assert "carry the arm's weight until you press Enter" in result.err
    assert "The arm holds its position." in result.err
    there = result.json["joints_rad"]
    where = {joint["name"]: joint for joint in run_cli(f"where {SIM} --json").json["joints"]}
    assert set(there) == set(where)


def test_teach_float_ends_after_given_time_without_terminal(run_cli):
    result = run_cli(f"teach cup --float --for 1.5s {SIM} --json")
    assert result.code == 0, result.err
    assert "carry the arm's weight for 1.5 s" in result.err


def test_record_command_prints_start_only_after_file_exists(run_cli, tmp_path, monkeypatch):
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    path = tmp_path / "wave.jsonl"
    messages = []

    def noted(text):
        messages.append((text, path.exists()))
        raise KeyboardInterrupt

    monkeypatch.setattr("ikservo.apps.teaching.record_command.print_status", noted)
    assert run_cli(f"record {path} --arm so101 --port sim").code == 0
    assert messages == [("Recording; Ctrl-C ends it.", True)]


@pytest.mark.parametrize(("celsius", "colour"), [(39.9, ""), (40.0, "yellow"), (45.0, "red")])
def test_where_command_colours_temperature_by_arm_limits(celsius, colour):
    limits = HealthLimits(warn_c=40.0, hold_c=45.0, release_c=50.0)
    assert heat_colour(celsius, limits) == colour


@pytest.mark.parametrize(("position_rad", "colour"), [(1.1, "red"), (0.95, "yellow"), (0.85, "")])
def test_where_command_colours_joint_near_and_beyond_limit(position_rad, colour):
    state = JointState("wrist", position_rad, -1.0, 1.0, "arm file", 31.0, 12.1, 4.0, torque=True)
    assert limit_colour(state, "rad") == colour


def test_teach_command_prints_instructions_before_waiting(run_cli, monkeypatch, tmp_path):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    monkeypatch.setattr("sys.stdin.isatty", lambda: True)
    monkeypatch.setattr("ikservo.apps.teaching.teach_command.wait_for_enter", lambda _: None)
    first = run_cli("teach cup --arm so101 --port sim").err.splitlines()[0]
    reported = 'move the arm by hand. Press Enter to save its pose as "cup"; then torque stays off.'
    assert first == f"Torque stays off; {reported}"

"""``ikservo move`` with lines, waypoints and orientations, and its output before the motion."""

import math

import numpy as np
import pytest

from ikservo.arm import MotionProgress
from ikservo.cli.open_and_confirm import motion_progress_bar
from ikservo.errors import ExitCode

SO101 = "--arm so101 --port sim"


@pytest.mark.campaign
def test_move_line_reaches_target_with_same_report_as_move(run_cli):
    result = run_cli(f"move 0.25 0.05 0.15 --line {SO101} --json")
    assert result.code == 0
    np.testing.assert_allclose(result.json["measured_tip_m"], (0.25, 0.05, 0.15), atol=2e-3)


def test_move_via_option_accepts_lengths_with_and_without_unit(run_cli):
    result = run_cli(
        f"move 0.25 0.05 0.15 --via 0.22,-20mm,0.2 --blend 3cm {SO101} --dry-run --json"
    )
    assert result.code == 0
    straight = run_cli(f"move 0.25 0.05 0.15 {SO101} --dry-run --json")
    assert result.json["path_m"] > straight.json["path_m"]


def test_move_dry_run_json_has_time_path_speed_and_limits(run_cli):
    answer = run_cli(f"move 0.25 0.05 0.15 --line {SO101} --dry-run --json").json
    assert set(answer) == {
        "schema", "target_m", "q_rad", "joints_rad", "duration_s", "path_m", "speed", "around",
        "kept", "clearance_m", "binding", "near_limits", "orientation_error_rad",
        "orientation_requested", "tool_speed",
    }  # fmt: skip
    assert answer["path_m"] > 0.05
    assert answer["binding"]
    assert {"joint", "side", "room_rad"} == set(answer["near_limits"][0])


def test_move_dry_run_text_lists_duration_path_and_speed(run_cli):
    lines = run_cli(f"move 0.25 0.05 0.15 {SO101} --dry-run").out.splitlines()
    words = [line.split()[0] for line in lines[5:]]
    assert words[:3] == ["duration", "path", "speed"]
    assert words[-1] == "tool"


def test_move_announces_that_first_motion_is_slow(run_cli):
    result = run_cli(f"move 0.25 0.05 0.15 --speed fast {SO101} --dry-run")
    assert "First motion after torque-on: slow speed." in result.err
    assert "slow." in result.err.splitlines()[0]


def test_move_pitch_option_accepts_negative_angle(run_cli):
    result = run_cli(f"move 0.25 0.05 0.15 --pitch -60 {SO101} --dry-run --json")
    assert result.code == 0
    assert abs(result.json["orientation_error_rad"]) < math.radians(0.5)


def test_move_with_impossible_orientation_exits_7(run_cli):
    result = run_cli(f"move 0.25 0.05 0.15 --pitch 40 {SO101}")
    assert result.code == 7
    assert result.out == ""
    assert "pitch 40.0° is not possible at" in result.err
    assert "Closest orientation there: pitch" in result.err


@pytest.mark.parametrize(("words", "code", "printed_words"), [
    ("move 0.25 0.05 0.15 --pitch 20 --keep", 2, "given twice"),
    ("move 0.25 0.05 0.15 --pitch 20 --direction 1,0,0", 2, "given twice"),
    ("move 0.25 0.05 0.15 --pitch 120", 2, "at most ±90°"),
    ("move 0.25 0.05 0.15 --within 10", 2, "no tool orientation to apply to"),
    ("move 0.25 0.05 0.15 --pitch 0 --within 0.1", 2, "0.5° to 180°"),
    ("move 0.25 0.05 0.15 --pitch 40 --within 2", 7, "within 2.0° is not possible at"),
    ("move 0.25 0.05 0.15 --pitch steep", 2, "is not an angle"),
    ("move 0.25 0.05 0.15 --direction up", 2, "is not a direction"),
    ("move 0.25 0.05 0.15 --direction 0,0,0", 2, "zero"),
    ("move 0.25 0.05 0.15 --via 0.2,0.1", 2, "is not a point"),
    ("move 0.25 0.05 0.15 --via 0.2,0.1,far", 2, "is not a length"),
    ("move 0.25 0.05 0.15 --via 0.2,0,0.2 --blend 0", 2, "blend"),
    ("move 0.25 0.05 0.15 --via 0.2,0,0.2 --blend wide", 2, "is not a length"),
    ("move 0.25 0.05 0.15 --via 0.9,0,0.2", 7, "(0.900, 0.000, 0.200) m cannot be reached"),
    ("move 0.9 0.05 0.15 --line", 7, "cannot be reached"),
])  # fmt: skip
def test_move_with_invalid_options_gives_one_message(run_cli, words, code, printed_words):
    result = run_cli(f"{words} {SO101}")
    assert result.code == code
    assert printed_words in result.err
    assert "Traceback" not in result.err


def test_joints_and_pose_commands_have_a_dry_run(run_cli):
    for words in ("joints elbow_flex=30 gripper=20", "pose home"):
        answer = run_cli(f"{words} {SO101} --dry-run --json").json
        assert answer["schema"] == "ikservo/plan/1"
        assert answer["path_m"] > 0.0
        assert answer["binding"]
    result = run_cli(f"joints elbow_flex=30 gripper=20 {SO101} --dry-run")
    assert result.out.splitlines()[:2] == ["elbow_flex  30.0°", "gripper     20.0°"]
    assert "slow" in result.err.splitlines()[0]


def test_joints_dry_run_outside_limits_exits_8(run_cli):
    assert run_cli(f"joints elbow_flex=170 {SO101} --dry-run").code == 8


def test_progress_bar_is_drawn_for_motion_of_unknown_duration(monkeypatch, capsys):
    monkeypatch.setenv("TERM", "xterm")  # on a dumb terminal there is no bar
    monkeypatch.setenv("FORCE_COLOR", "1")
    monkeypatch.setattr("sys.stderr.isatty", lambda: True)
    with motion_progress_bar() as draw:
        for time_s in (0.0, 0.1, 0.2):
            draw(MotionProgress(time_s, math.inf, np.zeros(3)))
    assert "(0.000, 0.000, 0.000) m" in capsys.readouterr().err


def test_move_refuses_target_inside_scene_object(run_cli, tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text('[[sphere]]\nname = "the ball"\ncentre_m = [0.25, 0, 0.15]\nradius_m = 0.03\n')
    answer = run_cli(f"move 0.25 0 0.15 {SO101} --scene {scene}")
    assert answer.code == ExitCode.REFUSED
    assert "the ball" in answer.err


KOCH = '[[arm]]\nname = "the koch"\narm = "koch"\nat_m = [0.45, 0, 0]\nrpy_deg = [0, 0, 180]\n'


def test_move_avoids_second_arm_at_its_measured_position(run_cli, tmp_path):
    scene = tmp_path / "scene.toml"
    scene.write_text(f'{KOCH}port = "sim:?pose=home"\n')
    among = run_cli(f"move 0.3 0 0.15 --straight {SO101} --scene {scene}")
    assert among.code == ExitCode.REFUSED
    assert "the koch's" in among.err
    assert run_cli(f"move 0.2 0.1 0.12 {SO101} --scene {scene}").code == 0


@pytest.mark.parametrize(
    ("port", "options", "code", "sentence"),
    [
        ("", "", 2, 'as in: port = "/dev/ttyUSB1"'),
        ("/dev/ttyNOTHERE", "", 3, "/dev/ttyNOTHERE"),
        ("sim:?pose=home", "--no-collision", ExitCode.REFUSED, "without collision checks"),
    ],
)
def test_move_refuses_scene_with_unmeasurable_second_arm(
    run_cli, tmp_path, port, options, code, sentence
):
    scene = tmp_path / "scene.toml"
    scene.write_text(KOCH + (f'port = "{port}"\n' if port else ""))
    answer = run_cli(f"move 0.2 0.1 0.12 {SO101} {options} --scene {scene}")
    assert (answer.code, sentence in answer.err) == (code, True)

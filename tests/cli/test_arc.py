"""``ikservo arc`` and ``--tool-speed``: output and refusals."""

import math

import pytest

SIM = "--arm so101 --port sim:?pose=home"


@pytest.mark.full
def test_arc_command_prints_same_report_as_move(run_cli):
    answer = run_cli(f"arc 0.20 -0.05 0.12 --via 0.23,0,120mm {SIM} --json").json
    assert answer["schema"] == "ikservo/move/1"
    assert answer["reached"]
    assert math.dist(answer["measured_tip_m"], (0.2, -0.05, 0.12)) < 2e-3
    assert answer["path_error_rms_m"] > 0.0


@pytest.mark.campaign
def test_circle_command_ends_where_it_began(run_cli):
    result = run_cli(f"arc --center 0.18,0,0.08 --tool-speed 40 {SIM} --json")
    assert result.code == 0
    assert result.json["error_m"] < 2e-3


def test_arc_dry_run_reports_length_and_tool_speed(run_cli):
    preview = f"arc --center 0.18,0,0.08 --angle -180 {SIM} --dry-run"
    answer = run_cli(f"{preview} --tool-speed 20mm/s --json").json
    radius_m = math.dist(answer["target_m"][:2], (0.18, 0.0))
    assert answer["path_m"] == pytest.approx(math.pi * radius_m, rel=2e-3)
    assert answer["tool_speed"]["requested_m_s"] == 0.02
    text = run_cli(f"{preview} --tool-speed 20").out
    assert "tip      20.0 mm/s, constant except for the ramps at both ends" in text


@pytest.mark.full
def test_move_warns_that_requested_tool_speed_is_not_reached(run_cli):
    result = run_cli(f"move 0.2 0.1 0.15 --line --tool-speed 400 {SIM}")
    assert result.code == 0
    assert "Tool speed: at most " in result.err


@pytest.mark.parametrize(
    ("words", "code", "message"),
    [
        ("arc", 2, "given by nothing"),
        ("arc 0.2 0.05", 2, "needs X Y Z"),
        ("arc 0.2 0.05 0.12", 2, "given by an end"),
        ("arc --via 0.2,0,0.1", 2, "given by a via point"),
        ("arc 0.2 0 0.1 --via 0.2,0.05,0.1 --center 0.2,0,0", 2, "and a centre"),
        ("arc 0.2 0 0.1 --via 0.2,0.05", 2, "is not a point"),
        ("arc 0.2 0 0.1 --via 0.2,nan,0", 2, "is not a length"),
        ("arc 0.2 0 0.1 --via 200mm,0,0.1", 2, "are the same"),
        ("arc --center 0.2,0,0.1 --normal q", 2, "is not a direction"),
        ("arc --center 0.2,0,0.1 --normal 0,0,0", 2, "normal of the circle is zero"),
        ("arc --center 0.2,0,0.1 --angle 0", 2, "angle of the arc is 0"),
        ("arc --center 0.2,0,0.1 --angle 3601", 2, "up to ten turns"),
        ("arc 0.8 0 0.1 --via 0.5,0.05,0.2", 7, "cannot be reached"),
        ("arc --center 0.21,0,0.03 --normal y", 8, "the table"),
        ("move 0.2 0 0.1 --line --tool-speed 0", 2, "not a speed above 0"),
        ("move 0.2 0 0.1 --line --tool-speed -5", 2, "not a speed above 0"),
        ("move 0.2 0 0.1 --line --tool-speed quick", 2, "is not a speed such as"),
        ("move 0.2 0 0.1 --line --tool-speed nan", 2, "is not a speed such as"),
        ("move 0.2 0 0.1 --tool-speed 50", 2, "Move in straight lines"),
    ],
)
def test_arc_command_refuses_invalid_arc_and_tool_speed(run_cli, words, code, message):
    result = run_cli(f"{words} {SIM}")
    assert result.code == code
    assert message in result.err
    assert result.out == ""

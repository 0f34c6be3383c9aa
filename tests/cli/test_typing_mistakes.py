"""Typing mistakes: millimetres, decimal commas, points out of reach, a .urdf for an arm."""

import pytest

from ikservo.cli import main

SIM = "--arm so101 --port sim:?pose=home"


def test_move_far_beyond_reach_asks_about_millimetres(run_cli):
    result = run_cli(f"move 250 50 150 {SIM}")
    assert result.code == 7
    assert "Did you mean millimetres? Try: ikservo move 250mm 50mm 150mm --arm so101" in result.err


@pytest.mark.parametrize("words", ["solve 250 50 150", "workspace --point 250 50 150"])
def test_solve_and_workspace_suggest_mm_for_large_numbers(run_cli, words):
    result = run_cli(f"{words} --arm so101")
    assert result.code == 7
    assert "Did you mean millimetres?" in result.err
    assert "250mm 50mm 150mm" in result.err


def test_millimetre_hint_is_omitted_if_point_stays_unreachable(run_cli):
    assert "millimetres" not in run_cli(f"move 0.9 0 0.1 {SIM}").err
    assert "millimetres" not in run_cli(f"move 9000 0 0 {SIM}").err


@pytest.mark.parametrize("words", ["move 0,25 0.05 0.15", "joints elbow_flex=0,25"])
def test_decimal_comma_error_suggests_decimal_point(run_cli, words):
    result = run_cli(f"{words} {SIM}")
    assert result.code == 2
    assert "'0,25' has a comma; use a decimal point: 0.25" in result.err


@pytest.mark.parametrize("words", ["workspace --slice left", "mcp --allow fast --port sim"])
def test_invalid_option_value_error_lists_valid_values(run_cli, words):
    result = run_cli(f"{words} --arm so101")
    assert result.code == 2
    assert "Value error" not in result.err
    assert " is not one of '" in result.err


@pytest.mark.full
@pytest.mark.parametrize("point", ["0.9 0 0.1", "0.35 0 -0.2", "-0.6 0.1 0.0", "0.1 0.1 0.9"])
def test_point_suggested_by_move_error_is_accepted(run_cli, point):
    result = run_cli(f"move {point} {SIM}")
    assert result.code in (7, 8)
    if "Try: ikservo " in result.err:
        words = result.err.strip().rpartition("Try: ikservo ")[2].replace("'", "").split()
        assert main([*words, "--dry-run"]) == 0


def test_pitch_beyond_its_range_is_reported_in_degrees(run_cli):
    assert "The pitch is 100°." in run_cli(f"move 0.25 0.05 0.15 --pitch 100 {SIM}").err


def test_command_with_plain_urdf_asks_for_tip_or_arm_file(run_cli):
    urdf = "configs/so101/arm.urdf"
    assert "--tip" in run_cli(f"move 0.25 0.05 0.15 --arm {urdf} --port sim").err
    result = run_cli(f"move 0.25 0.05 0.15 --arm {urdf} --tip gripper_frame --port sim")
    assert result.code == 2
    assert "has no servos" in result.err
    assert "arm.toml" in result.err


@pytest.mark.campaign
def test_tip_option_changes_link_that_is_moved_to_point(run_cli):
    plain = run_cli(f"move 0.22 0.02 0.12 {SIM} --dry-run --json").json
    other = run_cli(f"move 0.22 0.02 0.12 --tip gripper {SIM} --dry-run --json").json
    assert other["joints_rad"] != plain["joints_rad"]


def test_solve_and_move_plan_print_joints_in_same_form(run_cli):
    solved = run_cli("solve 0.22 0.02 0.12 --arm so101")
    planned = run_cli(f"move 0.22 0.02 0.12 {SIM} --dry-run")
    for result in (solved, planned):
        assert result.out.splitlines()[1].split()[0] == "shoulder_lift"
        assert result.out.splitlines()[1].endswith("°")
    names = set(run_cli("solve 0.22 0.02 0.12 --arm so101 --json").json["joints_rad"])
    assert names == set(run_cli(f"move 0.22 0.02 0.12 {SIM} --dry-run --json").json["joints_rad"])

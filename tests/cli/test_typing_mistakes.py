"""What a person mistypes: millimetres, decimal commas, points out of reach, a .urdf for an arm."""

import pytest

from ikservo.cli import main

SIM = "--arm so101 --port sim:?pose=home"


def test_numbers_far_beyond_the_arm_are_asked_about_as_millimetres(say):
    said = say(f"move 250 50 150 {SIM}")
    assert said.code == 7
    assert "Did you mean millimetres? Try: ikservo move 250mm 50mm 150mm --arm so101" in said.err


@pytest.mark.parametrize("words", ["solve 250 50 150", "workspace --point 250 50 150"])
def test_solve_and_workspace_ask_as_well(say, words):
    said = say(f"{words} --arm so101")
    assert said.code == 7
    assert "Did you mean millimetres?" in said.err
    assert "250mm 50mm 150mm" in said.err


def test_a_point_that_is_no_nearer_in_millimetres_is_not_asked_about(say):
    assert "millimetres" not in say(f"move 0.9 0 0.1 {SIM}").err
    assert "millimetres" not in say(f"move 9000 0 0 {SIM}").err


@pytest.mark.parametrize("words", ["move 0,25 0.05 0.15", "joints elbow_flex=0,25"])
def test_a_decimal_comma_is_answered_with_a_point(say, words):
    said = say(f"{words} {SIM}")
    assert said.code == 2
    assert "'0,25' has a comma; use a decimal point: 0.25" in said.err


@pytest.mark.parametrize("point", ["0.9 0 0.1", "0.35 0 -0.2", "-0.6 0.1 0.0", "0.1 0.1 0.9"])
def test_a_suggested_point_is_one_that_is_accepted(say, point):
    said = say(f"move {point} {SIM}")
    assert said.code in (7, 8)
    if "Try: ikservo " in said.err:
        words = said.err.strip().rpartition("Try: ikservo ")[2].replace("'", "").split()
        assert main([*words, "--dry-run"]) == 0


def test_an_angle_beyond_its_range_is_told_in_degrees(say):
    assert "The pitch is 100°." in say(f"move 0.25 0.05 0.15 --pitch 100 {SIM}").err


def test_a_urdf_without_servos_names_what_is_missing_once_its_tip_is_given(say):
    urdf = "configs/so101/arm.urdf"
    assert "--tip" in say(f"move 0.25 0.05 0.15 --arm {urdf} --port sim").err
    said = say(f"move 0.25 0.05 0.15 --arm {urdf} --tip gripper_frame --port sim")
    assert said.code == 2
    assert "has no servos" in said.err
    assert "arm.toml" in said.err


def test_another_link_can_be_the_tip_of_a_move(say):
    plain = say(f"move 0.22 0.02 0.12 {SIM} --dry-run --json").json
    other = say(f"move 0.22 0.02 0.12 --tip gripper {SIM} --dry-run --json").json
    assert other["joints_rad"] != plain["joints_rad"]


def test_joints_have_one_form_in_solve_and_in_plans(say):
    solved = say("solve 0.22 0.02 0.12 --arm so101")
    planned = say(f"move 0.22 0.02 0.12 {SIM} --dry-run")
    for said in (solved, planned):
        assert said.out.splitlines()[1].split()[0] == "shoulder_lift"
        assert said.out.splitlines()[1].endswith("°")
    names = set(say("solve 0.22 0.02 0.12 --arm so101 --json").json["joints_rad"])
    assert names == set(say(f"move 0.22 0.02 0.12 {SIM} --dry-run --json").json["joints_rad"])

"""``ikservo move`` and related commands on the simulated bus, word for word."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

pytestmark = pytest.mark.smoke


@pytest.mark.full
@pytest.mark.sample(1)
@pytest.mark.parametrize("arm", ["so101", "open_manipulator_x"])
def test_move_brings_measured_tip_within_2_mm(run_cli, arm):
    result = run_cli(f"move 0.25 0.05 0.15 --arm {arm} --port sim:?pose=home --json")
    assert result.code == 0
    np.testing.assert_allclose(result.json["measured_tip_m"], (0.25, 0.05, 0.15), atol=2e-3)


def test_move_json_has_the_expected_keys(run_cli):
    answer = run_cli("move 0.23 0.02 0.10 --arm so101 --port sim:?pose=home --json").json
    assert answer["schema"] == "ikservo/move/1"
    assert set(answer) == {
        "schema", "target_m", "commanded_tip_m", "measured_tip_m", "error_m", "duration_s",
        "reached", "binding", "orientation_error_rad", "orientation_requested",
        "orientation_change_rad", "path_error_rms_m", "path_error_max_m",
    }  # fmt: skip


@pytest.mark.full
def test_move_reports_path_error_only_for_a_line(run_cli):
    move = "move 0.23 0.02 0.10 --arm so101 --port sim:?pose=home"
    line = run_cli(f"{move} --line --json").json
    assert 0.0 < line["path_error_rms_m"] < line["path_error_max_m"] < 0.03
    assert run_cli(f"{move} --json").json["path_error_rms_m"] is None
    assert re.search(r"^path error \d+\.\d\d mm rms, \d+\.\d\d mm at most$",
                     run_cli(f"{move} --line").out, re.MULTILINE)  # fmt: skip
    assert "path error" not in run_cli(move).out


def test_move_prints_report_to_stdout_and_notice_to_stderr(run_cli):
    result = run_cli("move 0.23 0.02 0.10 --arm so101 --port sim:?pose=home")
    assert result.out.splitlines()[0] == "target     (0.230, 0.020, 0.100) m"
    assert result.out.splitlines()[-1] == "reached    yes"
    assert result.err.startswith("SO-101 follower on sim to (0.230, 0.020, 0.100) m: ")


def test_move_dry_run_prints_plan_and_its_joints(run_cli):
    answer = run_cli("move 0.25 0.05 0.15 --arm so101 --port sim --dry-run --json").json
    assert answer["schema"] == "ikservo/plan/1"
    assert set(answer["q_rad"]) == {"shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex",
                                    "wrist_roll"}  # fmt: skip


def test_where_json_has_expected_keys(run_cli):
    answer = run_cli("where --arm so101 --port sim --json").json
    assert set(answer) == {"schema", "tip_m", "joints", "conditioning", "singularity"}
    assert set(answer["joints"][0]) >= {
        "name", "position_rad", "lower_rad", "upper_rad", "limit_from", "temperature_c",
        "voltage_v", "load_percent", "torque",
    }  # fmt: skip


def test_where_command_names_source_of_joint_limits(run_cli):
    joints = run_cli("where --arm wx250s --port sim --json").json["joints"]
    assert {joint["limit_from"] for joint in joints} <= {
        "arm file", "servo register", "arm file / servo register", "servo register / arm file"
    }  # fmt: skip
    assert "arm file" in run_cli("where --arm so101 --port sim").out


@pytest.mark.full
def test_joints_command_accepts_degrees_and_radians(run_cli):
    result = run_cli("joints elbow_flex=30 gripper=0.5rad --arm so101 --port sim:?pose=home --json")
    assert result.code == 0
    assert result.json["goal_rad"] == pytest.approx({"elbow_flex": math.pi / 6, "gripper": 0.5})


def test_joints_command_accepts_negative_angle(run_cli):
    goal = run_cli("joints shoulder_pan=-5 --arm so101 --port sim --json").json["goal_rad"]
    assert goal == pytest.approx({"shoulder_pan": math.radians(-5.0)})


@pytest.mark.full
def test_joints_command_accepts_millimetres_for_sliding_joint(run_cli):
    goal = run_cli("joints gripper=10mm --arm open_manipulator_x --port sim --json").json[
        "goal_rad"
    ]
    assert goal == pytest.approx({"gripper": 0.01})


@pytest.mark.campaign
def test_pose_command_moves_to_a_named_pose(run_cli):
    result = run_cli("pose home --arm so101 --port sim --json")
    assert result.json["reached"] is True


def test_relax_reports_motion_to_rest_pose(run_cli):
    result = run_cli("relax --arm so101 --port sim --json")
    assert result.json["reached"] is True
    assert set(result.json["goal_rad"]) >= {"shoulder_lift", "gripper"}


def test_arms_command_lists_all_shipped_arms(run_cli):
    names = [arm["name"] for arm in run_cli("arms --json").json["arms"]]
    assert names == [
        "koch", "omx_f", "omx_l", "open_manipulator_x", "planar2", "planar3", "px100", "px150",
        "rx150", "rx200", "so100", "so101", "vx250", "vx300s", "wx200", "wx250s",
    ]  # fmt: skip


def test_arms_command_reports_unusual_base_frame(run_cli):
    frames = run_cli("arms").out.partition("base frame")[2].splitlines()
    (so101,) = [line for line in frames if line.startswith("so101")]
    assert "the maker's: origin 38.84 mm behind the first axis" in so101


@pytest.mark.full
def test_move_without_orientation_reports_how_tool_turned(run_cli):
    result = run_cli("move 0.23 0.02 0.10 --arm so101 --port sim:?pose=home")
    assert re.search(r"^tool       orientation changed by \d+\.\d° \(none was requested\)$",
                     result.out, re.M)  # fmt: skip


@pytest.mark.full
def test_move_reports_error_of_requested_orientation(run_cli):
    result = run_cli("move 0.25 0.05 0.15 --pitch -60 --arm so101 --port sim:?pose=home")
    assert re.search(r"^tool       orientation error 0\.\d°$", result.out, re.M)


PAN_TILT = Path(__file__).parents[2] / "examples" / "arms" / "pan_tilt" / "arm.toml"


def test_look_at_command_turns_pan_tilt_and_reports_joints(run_cli):
    looked = run_cli(f"move --look-at 1 0.5 -0.2 --arm {PAN_TILT} --port sim --json").json
    assert looked["schema"] == "ikservo/joints/1"
    assert looked["reached"]
    assert looked["goal_rad"]["pan"] == pytest.approx(math.atan2(0.5, 1.0), abs=1e-3)
    assert set(looked["goal_rad"]) == {"pan", "tilt"}


def test_look_at_dry_run_prints_a_plan(run_cli):
    answer = run_cli("move --look-at 500mm 0 0.1 --arm so101 --port sim --dry-run --json").json
    assert answer["schema"] == "ikservo/plan/1"
    assert set(answer["q_rad"]) == {
        "shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll",
    }  # fmt: skip


@pytest.mark.parametrize("option", ["--line", "--pitch -60", "--via 0.2,0,0.2", "--keep"])
def test_look_at_refuses_path_and_orientation_options(run_cli, option):
    result = run_cli(f"move --look-at 0.5 0 0.1 {option} --arm so101 --port sim")
    assert (result.code, result.out) == (2, "")
    assert f"--look-at cannot be given with {option.split()[0]}" in result.err


def test_look_at_refusal_reports_the_remaining_angle(run_cli):
    result = run_cli(f"move --look-at -1 0 0.1 --arm {PAN_TILT} --port sim")
    assert (result.code, result.out) == (7, "")
    assert "closest is 20." in result.err
    assert "pan at its" in result.err

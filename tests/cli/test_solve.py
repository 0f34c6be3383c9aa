"""``ikservo solve``: joints for a point, without hardware."""

import math

import numpy as np
import pytest

from ikservo.model import load_model
from tests.oracle import ARMS, tip_from_joints


def test_solve_joints_bring_tip_to_requested_point(run_cli):
    answer = run_cli("solve 0.25 0.05 0.15 --arm so101 --json").json
    names = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
    tip = tip_from_joints("so101", dict(zip(names, answer["q_rad"], strict=True)))
    np.testing.assert_allclose(tip, (0.25, 0.05, 0.15), atol=1e-5)


def test_solve_json_has_the_expected_keys(run_cli):
    assert set(run_cli("solve 0.25 0.05 0.15 --arm so101 --json").json) == {
        "schema", "reached", "q_rad", "joints_rad", "limit_from", "position_error_m",
        "orientation_error_rad", "method", "iterations", "nearest_m", "binding", "solutions",
        "conditioning", "singularity",
    }  # fmt: skip


def test_solve_accepts_units_after_numbers(run_cli):
    metres = run_cli("solve 0.25 -0.05 0.15 --arm so101 --json").json
    assert run_cli("solve 250mm -5cm .15m --arm so101 --json").json == metres


def test_solve_out_of_reach_exits_7_with_nearest_point(run_cli):
    result = run_cli("solve 0.9 0 0.2 --arm so101 --json")
    assert result.code == 7
    assert result.json["reached"] is False
    assert 0.3 < result.json["nearest_m"][0] < 0.5


def test_solve_text_gives_distance_to_nearest_point(run_cli):
    assert "mm away" in run_cli("solve 0.9 0 0.2 --arm so101").out


@pytest.mark.parametrize("arm", ARMS)
def test_solve_of_plain_urdf_needs_tip_option(run_cli, arm):
    result = run_cli(f"solve 0.1 0.1 0.1 --arm configs/{arm}/arm.urdf --json")
    assert result.code == 2
    assert "which link is the tool" in result.json["error"]


def test_solve_of_plain_urdf_with_tip_option_works(run_cli):
    result = run_cli("solve 0.25 0.05 0.15 --arm configs/so101/arm.urdf --tip gripper_frame --json")
    assert result.json["reached"] is True


def test_solve_command_without_arm_lists_arms(run_cli):
    result = run_cli("solve 0.2 0 0.1")
    assert result.code == 2
    assert "No arm given." in result.err
    assert "so101" in result.err


def test_solve_uses_arm_from_environment_variable(run_cli, monkeypatch):
    monkeypatch.setenv("IKSERVO_ARM", "so101")
    assert run_cli("solve 0.25 0.05 0.15").code == 0


def tool_of_so101(q_rad):
    """Return the pitch [deg] of the tool's axis, which is the z of the SO-101's tip."""
    chain = load_model("so101").chain
    return math.degrees(math.asin(chain.forward(q_rad)[2, 2]))


def test_solve_reaches_requested_pitch(run_cli):
    answer = run_cli("solve 0.2 0.05 0.1 --arm so101 --pitch -60 --json").json
    assert answer["reached"] is True
    assert tool_of_so101(answer["q_rad"]) == pytest.approx(-60.0, abs=0.5)


def test_solve_keep_option_keeps_orientation_of_home_pose(run_cli):
    model = load_model("wx250s")
    x, y, z = model.chain.forward(model.chain_pose("home"))[:3, 3] + (0.02, 0.03, 0.0)
    answer = run_cli(f"solve {x} {y} {z} --arm wx250s --keep --json").json
    turned = model.chain.forward(answer["q_rad"])[:3, :3]
    home = model.chain.forward(model.chain_pose("home"))[:3, :3]
    np.testing.assert_allclose(turned, home, atol=1e-2)


def test_solve_with_impossible_pitch_exits_7(run_cli):
    result = run_cli("solve 0.3 0 0.1 --arm so101 --pitch 89")
    assert result.code == 7
    assert "pitch 89.0° is not possible at" in result.err


def test_solve_direction_applies_to_the_tool_axis_of_the_arm(run_cli):
    answer = run_cli("solve 0.15 0 0.05 --arm px100 --direction 0,0,-1 --json").json
    pointed = load_model("px100").chain.forward(answer["q_rad"])[:3, 0]
    np.testing.assert_allclose(pointed, (0, 0, -1), atol=1e-3)


@pytest.mark.parametrize(
    "other", ["--all", "--compare", "--trace", "--method ccd", "--tool-axis z"]
)
def test_solve_refuses_pitch_with_conflicting_options(run_cli, other):
    result = run_cli(f"solve 0.2 0.05 0.1 --arm so101 --pitch -60 {other}")
    assert result.code == 2
    assert "cannot be combined" in result.err


def test_solve_refuses_direction_together_with_pitch(run_cli):
    result = run_cli("solve 0.25 0.05 0.15 --arm so101 --direction 0,1,0 --pitch 30")
    assert result.code == 2
    assert "a direction or a pitch" in result.err

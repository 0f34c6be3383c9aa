"""``ikservo solve``: other solutions, conditioning and torques in its output."""

import numpy as np
import pytest

from ikservo.kinematics import joint_torques
from ikservo.model import load_model
from tests.oracle import ARMS


def test_solve_reports_whether_other_solutions_exist(run_cli):
    assert "one of 2 solutions" in run_cli("solve 0.2 0.1 0.05 --arm planar2").out
    assert "one-parameter family" in run_cli("solve 0.2 0.1 0.05 --arm planar3").out


def test_solve_json_has_kind_and_count_of_solutions(run_cli):
    found = run_cli("solve 0.2 0.1 0.05 --arm planar2 --json").json["solutions"]
    assert found == {"kind": "several", "count": 2, "freedom": 0}


def test_solve_out_of_reach_has_no_other_solutions(run_cli):
    assert run_cli("solve 0.9 0 0.2 --arm so101 --json").json["solutions"]["kind"] == "none"


def test_solve_reports_manipulability_and_singularity(run_cli):
    result = run_cli("solve 0.2 0.1 0.05 --arm planar2")
    assert "mm/rad" in result.out
    assert "manipulability" in result.out
    assert "° away (joint2 turns most)" in result.out


@pytest.mark.parametrize("arm", ARMS)
def test_solve_text_is_at_most_80_columns_wide(run_cli, arm):
    z = 0.05 if arm.startswith("planar") else 0.15
    result = run_cli(f"solve 0.15 0.05 {z} --arm {arm} --force 0.5 -12.25 -5")
    assert max(map(len, result.out.splitlines())) <= 80


def test_solve_force_torques_match_virtual_work(run_cli):
    answer = run_cli("solve 0.25 0.05 0.15 --arm so101 --force 1 -0.5N -500mN --json").json
    expected = joint_torques(load_model("so101").chain, answer["q_rad"], (1.0, -0.5, -0.5))
    np.testing.assert_allclose(answer["torques_nm"], expected)


def test_solve_force_text_has_a_torque_line_per_joint(run_cli):
    result = run_cli("solve 0.25 0.05 0.15 --arm so101 --force 0 0 -5")
    for name in load_model("so101").chain.names:
        assert any(
            line.startswith(name) and line.endswith("N m") for line in result.out.splitlines()
        )


@pytest.mark.parametrize("force", ["0 0 nan", "0 0 inf", "0 x 0", "0 0 5kg", "0 0"])
def test_solve_refuses_an_invalid_force(run_cli, force):
    assert run_cli(f"solve 0.25 0.05 0.15 --arm so101 --force {force}").code == 2


@pytest.mark.parametrize("other", ["--all", "--compare", "--trace"])
def test_solve_force_refuses_options_with_several_solutions(run_cli, other):
    result = run_cli(f"solve 0.25 0.05 0.15 --arm so101 --force 0 0 -5 {other}")
    assert result.code == 2
    assert "--force" in result.err


def test_solve_is_no_farther_from_start_than_without_nearest(run_cli):
    ask = "solve 0.25 0 0.25 --arm wx250s --direction 1,0,0.2 --json"
    first, nearest = run_cli(f"{ask} --no-nearest").json, run_cli(ask).json
    assert first["reached"]
    assert nearest["reached"]
    start = load_model("wx250s").chain_pose("home")
    way = [float(np.linalg.norm(np.array(a["q_rad"]) - start)) for a in (first, nearest)]
    assert way[1] <= way[0] + 1e-9

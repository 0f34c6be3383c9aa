"""``--prefer`` and ``--weight`` choose among the postures that a target allows (L10)."""

import math

import numpy as np
import pytest

from tests.oracle import tip_from_joints

NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
POINT = "0.25 0.05 0.15 --arm so101"


def joints(result):
    return dict(zip(NAMES, np.degrees(result.json["q_rad"]).tolist(), strict=True))


def test_preferred_joint_position_is_reached_with_tip_in_place(run_cli):
    result = run_cli(f"solve {POINT} --prefer wrist_roll=40 --json")
    q = joints(result)
    assert result.json["reached"]
    assert q["wrist_roll"] == pytest.approx(40.0, abs=0.1)
    radians = {name: math.radians(value) for name, value in q.items()}
    np.testing.assert_allclose(tip_from_joints("so101", radians), (0.25, 0.05, 0.15), atol=1e-5)


def test_preferred_posture_with_larger_weight_has_priority(run_cli):
    both = f"solve {POINT} --prefer elbow_flex=0 --prefer wrist_flex=0 --json"
    light = joints(run_cli(f"{both} --weight elbow_flex=0.1"))
    heavy = joints(run_cli(f"{both} --weight elbow_flex=10"))
    assert abs(heavy["elbow_flex"]) < abs(light["elbow_flex"]) - 5.0
    assert abs(heavy["wrist_flex"]) > abs(light["wrist_flex"]) + 5.0


def test_preferred_pose_can_be_overridden_for_single_joints(run_cli):
    q = joints(run_cli(f"solve {POINT} --prefer home --prefer wrist_roll=-30 --json"))
    assert q["wrist_roll"] == pytest.approx(-30.0, abs=1.0)


def test_pseudo_inverse_method_respects_preferred_joint_position(run_cli):
    result = run_cli(f"solve {POINT} --method pseudo_inverse --prefer wrist_roll=40 --json")
    assert result.json["method"] == "pseudo_inverse"
    assert joints(result)["wrist_roll"] == pytest.approx(40.0, abs=0.1)


def test_move_uses_preferred_joint_position(run_cli):
    result = run_cli(f"move {POINT} --port sim --yes --json --dry-run --prefer wrist_roll=40")
    assert result.json["q_rad"]["wrist_roll"] == pytest.approx(math.radians(40.0), abs=2e-3)


def test_preferred_posture_has_no_effect_without_redundancy(run_cli):
    result = run_cli("solve 0.15 0.05 0.05 --arm planar2 --prefer joint1=90")
    assert result.code == 0
    assert "no choice of posture" in result.err


@pytest.mark.parametrize(
    ("options", "why"),
    [
        ("--prefer knee=3", "no joint named 'knee'"),
        ("--prefer hme", "Did you mean home"),
        ("--prefer home --prefer rest", "one pose"),
        ("--prefer elbow_flex", "has no position"),
        ("--prefer elbow_flex=x", "not an angle"),
        ("--prefer elbow_flex=inf", "not an angle"),
        ("--prefer elbow_flex=1 --prefer elbow_flex=2", "given twice"),
        ("--weight elbow_flex=2", "there is no preferred position for elbow_flex"),
        ("--prefer home --weight elbow_flex=-1", "at least 0"),
        ("--prefer home --weight elbow_flex=nan", "at least 0"),
        ("--prefer home --weight elbow_flex", "not JOINT=NUMBER"),
        ("--prefer home --weight knee=1", "no joint named 'knee'"),
        ("--prefer home --method ccd", "--method auto or pseudo_inverse"),
        ("--prefer home --compare", "without --all, --compare"),
        ("--prefer home --pitch 0", "--pitch"),
    ],
)
def test_bad_preferred_posture_gives_usage_error(run_cli, options, why):
    result = run_cli(f"solve {POINT} {options}")
    assert result.code == 2
    assert why in result.err


@pytest.mark.parametrize("options", ["--line", "--pitch -30", "--keep"])
def test_move_refuses_preferred_posture_with_orientation(run_cli, options):
    result = run_cli(f"move {POINT} --port sim --yes --prefer home {options}")
    assert result.code == 2
    assert "posture" in result.err

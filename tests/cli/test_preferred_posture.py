"""``--prefer`` and ``--weight``: where the target leaves freedom, the person chooses (L10)."""

import math

import numpy as np
import pytest

from tests.oracle import tip_from_joints

NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")
POINT = "0.25 0.05 0.15 --arm so101"


def joints(said):
    return dict(zip(NAMES, np.degrees(said.json["q_rad"]).tolist(), strict=True))


def test_a_preferred_joint_goes_there_and_the_tip_stays(say):
    said = say(f"solve {POINT} --prefer wrist_roll=40 --json")
    q = joints(said)
    assert said.json["reached"]
    assert q["wrist_roll"] == pytest.approx(40.0, abs=0.1)
    radians = {name: math.radians(value) for name, value in q.items()}
    np.testing.assert_allclose(tip_from_joints("so101", radians), (0.25, 0.05, 0.15), atol=1e-5)


def test_of_two_preferences_that_contradict_each_other_the_heavier_wins(say):
    both = f"solve {POINT} --prefer elbow_flex=0 --prefer wrist_flex=0 --json"
    light = joints(say(f"{both} --weight elbow_flex=0.1"))
    heavy = joints(say(f"{both} --weight elbow_flex=10"))
    assert abs(heavy["elbow_flex"]) < abs(light["elbow_flex"]) - 5.0
    assert abs(heavy["wrist_flex"]) > abs(light["wrist_flex"]) + 5.0


def test_a_pose_is_preferred_by_its_name_and_single_joints_otherwise(say):
    q = joints(say(f"solve {POINT} --prefer home --prefer wrist_roll=-30 --json"))
    assert q["wrist_roll"] == pytest.approx(-30.0, abs=1.0)


def test_the_pseudo_inverse_leans_by_itself(say):
    said = say(f"solve {POINT} --method pseudo_inverse --prefer wrist_roll=40 --json")
    assert said.json["method"] == "pseudo_inverse"
    assert joints(said)["wrist_roll"] == pytest.approx(40.0, abs=0.1)


def test_a_move_takes_the_preferred_joints(say):
    said = say(f"move {POINT} --port sim --yes --json --dry-run --prefer wrist_roll=40")
    assert said.json["q_rad"]["wrist_roll"] == pytest.approx(math.radians(40.0), abs=2e-3)


def test_an_arm_without_freedom_says_that_nothing_changes(say):
    said = say("solve 0.15 0.05 0.05 --arm planar2 --prefer joint1=90")
    assert said.code == 0
    assert "no freedom" in said.err


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
        ("--weight elbow_flex=2", "nothing is preferred for elbow_flex"),
        ("--prefer home --weight elbow_flex=-1", "at least 0"),
        ("--prefer home --weight elbow_flex=nan", "at least 0"),
        ("--prefer home --weight elbow_flex", "not JOINT=NUMBER"),
        ("--prefer home --weight knee=1", "no joint named 'knee'"),
        ("--prefer home --method ccd", "--method auto or pseudo_inverse"),
        ("--prefer home --compare", "without --all, --compare"),
        ("--prefer home --pitch 0", "--pitch"),
    ],
)
def test_bad_preferences_are_usage_errors_that_say_why(say, options, why):
    said = say(f"solve {POINT} {options}")
    assert said.code == 2
    assert why in said.err


@pytest.mark.parametrize("options", ["--line", "--pitch -30", "--keep"])
def test_a_move_that_says_how_the_tool_stands_has_no_room_for_a_posture(say, options):
    said = say(f"move {POINT} --port sim --yes --prefer home {options}")
    assert said.code == 2
    assert "posture" in said.err

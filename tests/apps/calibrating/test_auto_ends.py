"""Messages about joints whose end stops cannot be searched for."""

import math

import pytest

from ikservo.apps.calibrating.auto_calibration import nearly_a_turn, unreached
from ikservo.calibration.uncalibrated_joint import JointUnderCalibration
from tests.calibration.mounted_arms import load_model

FLOOR = "gripper would overlap the table by 9 mm in the best posture found"


@pytest.fixture
def shoulder():
    joint = load_model("px100").joint("shoulder")
    return JointUnderCalibration(joint.joint_map, 4096, joint.limits, 0.0)


def test_auto_calibration_warns_why_end_stop_was_not_searched(shoulder):
    assert unreached(shoulder, math.radians(-110.0), FLOOR) == (
        f"cannot search for its end stop near 107.0° ({FLOOR}); the limit of the arm file is used "
        "instead; the other is at -110.0°."
    )


def test_auto_calibration_warning_names_both_unsearched_stops(shoulder):
    assert unreached(shoulder, "no room", FLOOR) == (
        f"cannot search for its end stop near -111.0° (no room), nor for its end stop near 107.0° "
        f"({FLOOR}); both limits of the arm file are used instead."
    )


def test_auto_calibration_warns_of_nearly_full_turn_range(shoulder):
    assert "not searched: its range in the arm file, -111.0° to 107.0°" in nearly_a_turn(shoulder)

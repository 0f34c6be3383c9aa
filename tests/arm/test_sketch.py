"""The arm in letters is drawn in the pose that is asked for."""

import pytest

from ikservo.errors import UnknownNameError
from ikservo.maintenance.arm_sketch import ascii_sketch
from tests.calibration.mounted_arms import load_model


def test_another_pose_is_another_picture():
    model = load_model("so101")
    assert ascii_sketch(model, "elbow_flex", "zero") != ascii_sketch(model, "elbow_flex", "rest")


def test_without_a_pose_it_is_home():
    model = load_model("so101")
    assert ascii_sketch(model, "elbow_flex") == ascii_sketch(model, "elbow_flex", "home")


def test_upright_is_drawn_upright():
    model = load_model("so101")
    rows = [
        row for row, line in enumerate(ascii_sketch(model, "elbow_flex", "zero")) if "@" in line
    ]
    base = [
        row for row, line in enumerate(ascii_sketch(model, "elbow_flex", "zero")) if "=" in line
    ]
    assert min(base) - min(rows) > 5


def test_a_pose_that_the_arm_does_not_have_names_those_it_has():
    with pytest.raises(UnknownNameError, match="home"):
        ascii_sketch(load_model("so101"), "elbow_flex", "folded")

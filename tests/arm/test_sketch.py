"""The arm in letters is drawn in the pose that is asked for."""

import pytest

from ikservo.arm.calibrating.sketch import sketch
from ikservo.errors import UnknownNameError
from tests.calibration.hidden import load_model


def test_another_pose_is_another_picture():
    model = load_model("so101")
    assert sketch(model, "elbow_flex", "zero") != sketch(model, "elbow_flex", "rest")


def test_without_a_pose_it_is_home():
    model = load_model("so101")
    assert sketch(model, "elbow_flex") == sketch(model, "elbow_flex", "home")


def test_upright_is_drawn_upright():
    model = load_model("so101")
    rows = [row for row, line in enumerate(sketch(model, "elbow_flex", "zero")) if "@" in line]
    base = [row for row, line in enumerate(sketch(model, "elbow_flex", "zero")) if "=" in line]
    assert min(base) - min(rows) > 5


def test_a_pose_that_the_arm_does_not_have_names_those_it_has():
    with pytest.raises(UnknownNameError, match="home"):
        sketch(load_model("so101"), "elbow_flex", "folded")

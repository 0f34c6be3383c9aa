"""Positions and sources of limits in readable words."""

import math

import pytest

from ikservo.calibration.joint_map import format_position, format_source


@pytest.mark.parametrize(
    ("position", "unit", "text"),
    [
        (math.pi, "rad", "180.0°"),
        (0.5, "m", "500.0 mm"),
        (-1e-9, "rad", "0.0°"),
        (-1e-9, "m", "0.0 mm"),
    ],
)
def test_calibrated_position_text_is_in_degrees_or_mm(position, unit, text):
    assert format_position(position, unit) == text


def test_position_text_precision_can_be_increased():
    assert (format_position(0.012345, "m", 2), format_position(0.1, "rad", 3)) == (
        "12.35 mm",
        "5.730°",
    )


def test_limit_set_by_user_is_described_as_set_by_you():
    assert format_source("arm file / user") == "arm file / set by you"

"""Near a limit is 5°, 5 mm of a slide, or a twentieth of a short range; at it 0.3° or 0.3 mm."""

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from ikservo.calibration.joint_limits import at_distance, limit_distance, near_limit

DEG = math.radians(1.0)


def at_limit(position, lower, upper, unit="rad"):
    return limit_distance(position, lower, upper) <= at_distance(lower, upper, unit)


@pytest.mark.parametrize(
    ("position", "unit", "near", "at"),
    [
        (95.1 * DEG, "rad", True, False),
        (94.9 * DEG, "rad", False, False),
        (-95.1 * DEG, "rad", True, False),
        (99.8 * DEG, "rad", True, True),
        (101.0 * DEG, "rad", True, True),
        (0.0, "rad", False, False),
    ],
)
def test_revolute_joint_is_near_limit_within_5_degrees(position, unit, near, at):
    joint = (position, -100 * DEG, 100 * DEG, unit)
    assert (near_limit(*joint), at_limit(*joint)) == (near, at)


@pytest.mark.parametrize(
    ("position_m", "near", "at"),
    [(0.2951, True, False), (0.2949, False, False), (0.2998, True, True), (0.0002, True, True)],
)
def test_prismatic_joint_is_near_limit_within_5_mm(position_m, near, at):
    joint = (position_m, 0.0, 0.3, "m")
    assert (near_limit(*joint), at_limit(*joint)) == (near, at)


def test_joint_with_short_range_is_near_limit_in_last_5_percent():
    assert near_limit(0.0195, 0.0, 0.02, "m")
    assert not near_limit(0.0185, 0.0, 0.02, "m")


def test_continuous_joint_is_never_near_limit():
    assert not near_limit(7.0, -math.inf, math.inf)
    assert limit_distance(7.0, -math.inf, math.inf) == math.inf


@given(st.floats(-2, 2), st.floats(-1, 0), st.floats(0, 1), st.sampled_from(["rad", "m"]))
def test_joint_at_limit_is_near_and_joint_outside_is_at_limit(position, lower, upper, unit):
    joint = (position, lower, upper, unit)
    assert near_limit(*joint) or not at_limit(*joint)
    assert at_limit(*joint) or limit_distance(*joint[:3]) >= 0.0

"""A limit is a value that remembers who said so."""

import pytest

from ikservo.calibration import Limits
from ikservo.errors import CalibrationError, ExitCode

ARM_FILE = Limits.of("elbow", -1.7, 1.7, "arm file")


def test_the_narrower_limit_binds_and_keeps_its_source():
    both = ARM_FILE.intersect(Limits.of("elbow", -2.0, 1.2, "servo register"))
    assert (both.lower.value, both.lower.source) == (-1.7, "arm file")
    assert (both.upper.value, both.upper.source) == (1.2, "servo register")


def test_two_sources_are_both_named():
    both = ARM_FILE.intersect(Limits.of("elbow", -2.0, 1.2, "servo register"))
    assert both.source == "arm file / servo register"


def test_of_equal_limits_the_first_source_stays():
    assert ARM_FILE.intersect(Limits.of("elbow", -1.7, 1.7, "user")).source == "arm file"


def test_an_empty_intersection_names_both_limits():
    with pytest.raises(CalibrationError, match=r"elbow.*\(user\).*\(arm file\)") as caught:
        ARM_FILE.intersect(Limits.of("elbow", 1.8, 2.0, "user"))
    assert caught.value.exit_code == ExitCode.CALIBRATION


def test_a_joint_that_slides_keeps_its_unit():
    jaws = Limits.of("jaws", 0.0, 0.04, "arm file", unit="m")
    assert jaws.intersect(Limits.of("jaws", 0.01, 0.05, "user", unit="m")).unit == "m"


def test_the_ends_belong_to_the_range():
    assert ARM_FILE.contains(-1.7)
    assert ARM_FILE.contains(1.7)
    assert not ARM_FILE.contains(1.7000001)


def test_a_joint_that_may_not_move_has_limits_too():
    held = Limits.of("elbow", 0.3, 0.3, "user")
    assert held.lower.value == held.upper.value

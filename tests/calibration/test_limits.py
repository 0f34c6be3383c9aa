"""A limit is a value with its source."""

import pytest

from ikservo.calibration import Limits
from ikservo.errors import CalibrationError, ExitCode

ARM_FILE = Limits.of("elbow", -1.7, 1.7, "arm file")


def test_narrower_joint_limit_applies_and_keeps_its_source():
    both = ARM_FILE.intersect(Limits.of("elbow", -2.0, 1.2, "servo register"))
    assert (both.lower.value, both.lower.source) == (-1.7, "arm file")
    assert (both.upper.value, both.upper.source) == (1.2, "servo register")


def test_joint_limits_from_two_sources_name_both_sources():
    both = ARM_FILE.intersect(Limits.of("elbow", -2.0, 1.2, "servo register"))
    assert both.source == "arm file / servo register"


def test_equal_joint_limits_keep_first_source():
    assert ARM_FILE.intersect(Limits.of("elbow", -1.7, 1.7, "user")).source == "arm file"


def test_error_for_disjoint_joint_limits_names_both_sources():
    with pytest.raises(CalibrationError, match=r"elbow.*\(user\).*\(arm file\)") as caught:
        ARM_FILE.intersect(Limits.of("elbow", 1.8, 2.0, "user"))
    assert caught.value.exit_code == ExitCode.CALIBRATION


def test_limits_of_sliding_joint_keep_metres():
    jaws = Limits.of("jaws", 0.0, 0.04, "arm file", unit="m")
    assert jaws.intersect(Limits.of("jaws", 0.01, 0.05, "user", unit="m")).unit == "m"


def test_joint_limits_include_their_end_values():
    assert ARM_FILE.contains(-1.7)
    assert ARM_FILE.contains(1.7)
    assert not ARM_FILE.contains(1.7000001)


def test_limits_of_a_fixed_joint_may_be_equal():
    held = Limits.of("elbow", 0.3, 0.3, "user")
    assert held.lower.value == held.upper.value

"""The bounds of every value of a calibration file: the last valid one and the first invalid."""

import json
import math

import pytest
from pydantic import ValidationError

from ikservo.calibration import Limits
from ikservo.calibration.records import Calibration
from tests.calibration.records import GEOMETRY, calibration_of, joint

ARM_FILE = Limits.of("elbow", -2.0, 2.0, "arm file")
UNSWEPT = {"swept": "not swept", "lower_deg": None, "upper_deg": None}

ORIGIN = {"joint": "elbow", "moved_mm": [0.0, 0.0, 0.0]}


def with_value(path, value):
    """Validate a calibration file in which one value is replaced."""
    filed = calibration_of(joint(), geometry=GEOMETRY | {"origins": [ORIGIN]})
    table = filed.model_dump(mode="json")
    inside = table
    for key in path[:-1]:
        inside = inside[key]
    assert path[-1] in (inside if isinstance(inside, dict) else range(len(inside)))
    inside[path[-1]] = value
    return Calibration.model_validate_json(json.dumps(table))


JOINT, GEOM = ("joints", 0), ("geometry",)
BOUNDS = [
    ((*JOINT, "servo", "id"), (0, 252), (-1, 253)),
    ((*JOINT, "servo", "holds", "phase"), (-(2**31), 2**32 - 1), (-(2**31) - 1, 2**32)),
    ((*JOINT, "zero_tick"), (-(2.0**20), 2.0**20), (-(2.0**20) - 1, 2.0**20 + 1)),
    ((*JOINT, "gear"), (1e-6, 1e6), (0.0, -0.5)),
    ((*JOINT, "travel_ticks", 0), (-(2**20), 2**20), (-(2**20) - 1, 2**20 + 1)),
    ((*JOINT, "travel_ticks", 1), (-(2**20), 2**20), (-(2**20) - 1, 2**20 + 1)),
    ((*GEOM, "touches"), (1, 10_000), (0, 10_001)),
    ((*GEOM, "left_out"), (0, 10_000), (-1, 10_001)),
    ((*GEOM, "before_mm"), (0.0, 1e3), (-0.1,)),
    ((*GEOM, "after_mm"), (0.0, 1e3), (-0.1,)),
    ((*GEOM, "base_moved_mm", 1), (-50.0, 50.0), (-50.1, 50.1)),
    ((*GEOM, "base_turned_deg", 2), (-20.0, 20.0), (-20.1, 20.1)),
    ((*GEOM, "origins", 0, "moved_mm", 0), (-50.0, 50.0), (-50.1, 50.1)),
    (("margin_deg",), (0.0, 44.9), (-0.1, 45.0)),
    (("joints",), (), ([],)),
]


@pytest.mark.parametrize(
    ("path", "value"), [(path, value) for path, inside, _ in BOUNDS for value in inside]
)
def test_calibration_values_at_their_bounds_are_accepted(path, value):
    with_value(path, value)


@pytest.mark.parametrize(
    ("path", "value"), [(path, value) for path, _, outside in BOUNDS for value in outside]
)
def test_calibration_values_outside_their_bounds_are_refused(path, value):
    with pytest.raises(ValidationError):
        with_value(path, value)


@pytest.mark.parametrize("path", [(*JOINT, "sign"), ("format",)])
@pytest.mark.parametrize("value", [True, 1.0, "1", 2, 0])
def test_calibration_sign_and_format_must_be_integers(path, value):
    assert with_value(path, 1)
    with pytest.raises(ValidationError):
        with_value(path, value)


@pytest.mark.parametrize(
    "path", [(*JOINT, "zero_tick"), (*JOINT, "gear"), (*JOINT, "lower_deg"), (*GEOM, "before_mm")]
)
@pytest.mark.parametrize("value", [math.nan, math.inf])
def test_calibration_numbers_must_be_finite(path, value):
    with pytest.raises(ValidationError):
        with_value(path, value)


def limits_of(**changes):
    """Return the limits of a joint, each in whole degrees and with its source."""
    filed = calibration_of(joint(**changes))
    limits = filed.narrow_limits(filed.joints[0], ARM_FILE)
    return [(round(math.degrees(end.value)), end.source) for end in (limits.lower, limits.upper)]


def test_joint_that_was_not_swept_has_arm_file_limits():
    assert limits_of(**UNSWEPT) == [(-115, "arm file"), (115, "arm file")]


@pytest.mark.parametrize(
    ("user", "limits"),
    [
        ({"user_lower_deg": -30.0}, [(-30, "user"), (80, "hand sweep of 2026-11-02")]),
        ({"user_upper_deg": 30.0}, [(-80, "hand sweep of 2026-11-02"), (30, "user")]),
        ({"user_lower_deg": 0.0, "user_upper_deg": 30.0}, [(0, "user"), (30, "user")]),
    ],
)
def test_user_limit_may_be_set_at_either_end_of_joint(user, limits):
    assert limits_of(**user) == limits

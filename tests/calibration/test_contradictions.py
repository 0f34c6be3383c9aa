"""Each contradiction between values of a calibration file is reported separately."""

import pytest

from ikservo.calibration.calibration_file import inconsistencies
from tests.calibration.records import FAMILIES, GEOMETRY, calibration_of, joint


def issues_of(*joints, **more):
    """Return the issues of a file with these joints, by place."""
    calibration = calibration_of(*joints, **more)
    return {c.location: (c.found, c.expected) for c in inconsistencies(calibration)}


@pytest.mark.parametrize("model", FAMILIES)
def test_consistent_joint_calibration_has_no_issue(model):
    travel = [100, 900] if model == "SCS15" else [1000, 3000]
    assert issues_of(joint(model=model, travel_ticks=travel)) == {}


def test_calibration_times_without_utc_offset_are_reported():
    naive = "2026-11-02T14:03:22"
    issues = issues_of(joint(), written=naive, geometry=GEOMETRY | {"touched": naive})
    assert {place: found for place, (found, _) in issues.items()} == {
        ("written",): "has no UTC offset", ("geometry", "touched"): "has no UTC offset",
    }  # fmt: skip


def test_calibration_reports_unknown_and_missing_registers():
    held = joint(holds={"homing_ofset": 0})
    del held["servo"]["holds"]["homing_offset"]
    place = ("joints", 0, "servo", "holds")
    assert issues_of(held) == {
        (*place, "homing_ofset"): ("is not a register", "a register of STS3215"),
        (*place, "homing_offset"): ("is missing", "the number that the servo held"),
    }


def test_unknown_servo_model_is_reported_as_only_issue():
    assert [*issues_of(joint(model="STS9999"))] == [("joints", 0, "servo", "model")]


def test_origin_moved_twice_by_touch_off_is_reported():
    origins = [{"joint": name, "moved_mm": [1.0, 0.0, 0.0]} for name in ("a", "b", "a", "b")]
    issues = issues_of(joint(), geometry=GEOMETRY | {"origins": origins})
    assert {place[2]: found for place, (found, _) in issues.items()} == {
        2: 'repeats "a"', 3: 'repeats "b"',
    }  # fmt: skip
    assert issues_of(joint(), geometry=GEOMETRY | {"origins": origins[:2]}) == {}


def test_duplicate_joint_name_or_id_is_reported_at_second_joint():
    issues = issues_of(joint(), joint("wrist", 2), joint("elbow", 1))
    assert issues == {
        ("joints", 2, "name"): ('repeats "elbow"', "a unique name"),
        ("joints", 2, "servo", "id"): ("repeats 1", "a unique id"),
    }


def test_issue_for_wrong_servo_family_lists_expected_models():
    stranger = joint("wrist", 2, model="SCS15", travel_ticks=[100, 900])
    found, expected = issues_of(joint(), stranger)["joints", 1, "servo", "model"]
    assert (found, expected) == ('is "SCS15"', "one of: STS3215, STS3250, STS3235, HLS3606M")


@pytest.mark.parametrize("tick", [0, 4095])
def test_calibration_register_values_at_range_ends_are_accepted(tick):
    assert issues_of(joint(holds={"max_position_limit": tick})) == {}


@pytest.mark.parametrize("tick", [-1, 4096])
def test_calibration_register_out_of_range_is_reported(tick):
    issues = issues_of(joint(holds={"max_position_limit": tick}))
    place = ("joints", 0, "servo", "holds", "max_position_limit")
    assert issues == {place: (f"is {tick}", "0 to 4095")}


PLACE = ("joints", 0, "travel_ticks")
APART, ON_THE_SENSOR = "50 to 4095 ticks apart", "ticks from 0 to 4095"


@pytest.mark.parametrize("travel", [[0, 50], [0, 4095], [4045, 4095]])
def test_joint_travel_of_50_ticks_to_full_turn_is_accepted(travel):
    assert issues_of(joint(travel_ticks=travel)) == {}


@pytest.mark.parametrize(
    ("travel", "expected"),
    [
        ([0, 49], APART),
        ([0, 4096], APART),
        ([300, 100], APART),
        ([-1, 1000], ON_THE_SENSOR),
        ([4000, 4096], ON_THE_SENSOR),
    ],
)
def test_impossible_joint_travel_is_reported_with_allowed_range(travel, expected):
    issues = issues_of(joint(travel_ticks=travel))
    assert issues == {PLACE: (f"is [{travel[0]}, {travel[1]}]", expected)}


def test_multi_turn_servo_may_travel_beyond_one_turn():
    assert issues_of(joint(model="XM430-W350", travel_ticks=[-900, 900], extended=True)) == {}
    assert issues_of(joint(model="XM430-W350", travel_ticks=[4000, 4200], extended=True)) == {}
    assert PLACE in issues_of(joint(model="XM430-W350", travel_ticks=[-900, 900]))


@pytest.mark.parametrize("offset", [1025, -1025])
def test_homing_offset_ignored_by_dynamixel_is_reported(offset):
    issues = issues_of(joint(model="XM430-W350", holds={"homing_offset": offset}))
    assert issues == {
        ("joints", 0, "servo", "holds", "homing_offset"): (f"is {offset}", "-1024 to 1024")
    }


@pytest.mark.parametrize("offset", [1024, -1024])
def test_homing_offset_of_1024_is_accepted_for_dynamixel(offset):
    assert issues_of(joint(model="XM430-W350", holds={"homing_offset": offset})) == {}


def test_multi_turn_dynamixel_may_have_any_homing_offset():
    far = joint(model="XM430-W350", holds={"homing_offset": -5000}, extended=True)
    assert issues_of(far) == {}


@pytest.mark.parametrize(("lower_deg", "upper_deg"), [(10.0, 10.0), (10.0, -10.0)])
def test_empty_joint_range_in_calibration_is_reported(lower_deg, upper_deg):
    issues = issues_of(joint(lower_deg=lower_deg, upper_deg=upper_deg))
    place = ("joints", 0, "lower_deg")
    assert issues == {place: ("is not below the upper limit", "lower < upper")}


@pytest.mark.parametrize(
    "changes", [{"lower_deg": None}, {"upper_deg": None}, {"swept": "not swept"}]
)
def test_joint_range_is_required_only_for_swept_joint(changes):
    assert [*issues_of(joint(**changes))] == [("joints", 0, "swept")]
    assert issues_of(joint(lower_deg=None, upper_deg=None, swept="not swept")) == {}

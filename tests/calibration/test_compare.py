"""A calibration file is compared with the servos on the line."""

import pytest

from ikservo.calibration.servo_config import ServoConfig, raise_on_mismatch, register_mismatches
from ikservo.errors import CalibrationError
from ikservo.registers import MODELS
from tests.calibration.records import STS, X, calibration_of, joint


def facts(servo_id, model="STS3215", **held):
    known = X if model == "XM430-W350" else STS
    return ServoConfig(servo_id, MODELS[model], "3.10", known | held)


def messages_of(found, *joints):
    calibration = calibration_of(*joints)
    return [str(each) for each in register_mismatches(calibration, {f.id: f for f in found})]


def test_servos_that_match_calibration_give_no_message():
    assert messages_of([facts(1), facts(2)], joint(), joint("wrist", 2)) == []


def test_changed_servo_register_is_reported_with_both_values():
    assert messages_of([facts(1, homing_offset=7)], joint()) == [
        "homing_offset of elbow (id 1) is 7 in the servo and 0 in the calibration"
    ]


def test_calibrated_servo_missing_in_arm_is_reported():
    (mismatch,) = register_mismatches(calibration_of(joint()), {})
    assert (mismatch.joint, mismatch.register, mismatch.expected, mismatch.found) == (
        "elbow", "id", "1", "absent",
    )  # fmt: skip


def test_replaced_servo_model_is_reported_as_only_mismatch():
    assert messages_of([facts(1, "STS3250", homing_offset=7)], joint()) == [
        "model of elbow (id 1) is STS3250 in the servo and STS3215 in the calibration"
    ]


def test_calibration_register_not_read_is_reported_as_unknown():
    bare = ServoConfig(1, MODELS["STS3215"], "", {k: v for k, v in STS.items() if k != "phase"})
    assert messages_of([bare], joint()) == [
        "phase of elbow (id 1) is unknown in the servo and 12 in the calibration"
    ]


@pytest.mark.parametrize(("drive_mode", "reported"), [(4, False), (1, True), (5, True)])
def test_drive_mode_bits_unrelated_to_direction_are_ignored(drive_mode, reported):
    found = facts(1, "XM430-W350", drive_mode=drive_mode)
    assert bool(messages_of([found], joint(model="XM430-W350"))) is reported


def test_servos_that_match_calibration_are_accepted():
    raise_on_mismatch([])


@pytest.mark.parametrize(("count", "rest"), [(1, "."), (2, ", and 1 more."), (4, ", and 3 more.")])
def test_error_names_first_register_mismatch_and_counts_others(count, rest):
    joints = [joint(f"j{i}", i) for i in range(1, count + 1)]
    found = {i: facts(i, homing_offset=9) for i in range(1, count + 1)}
    with pytest.raises(CalibrationError) as caught:
        raise_on_mismatch(register_mismatches(calibration_of(*joints), found))
    first = "homing_offset of j1 (id 1) is 9 in the servo and 0 in the calibration"
    assert caught.value.message == first + rest
    assert "ikservo calibration push" in caught.value.hint

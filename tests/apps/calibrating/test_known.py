"""A calibrated model without its servos has the same ranges and links as the opened arm."""

import math
from datetime import UTC, datetime, timedelta

import numpy as np
import pytest

import ikservo
from ikservo.apps.calibrating.calibration_result import CalibrationResult
from ikservo.calibration.calibration_file import save_calibration
from ikservo.calibration.records import CalibratedGeometry, CalibratedOrigin
from ikservo.errors import CalibrationError, FileFormatError
from ikservo.planning.calibrated_arm import calibrated_model
from tests.calibration.factories import make_calibration
from tests.calibration.mounted_arms import load_model, make_mounted_arm
from tests.oracle import CONFIGS

WHEN = datetime(2026, 11, 2, 14, 3, 22, tzinfo=UTC)


@pytest.fixture(autouse=True)
def _home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))


def calibration_of(name, **changes):
    arm = make_mounted_arm(name, 4, spoiled=False)
    with arm.open_limp() as limp_arm:
        return make_calibration(arm, limp_arm, WHEN).model_copy(update=changes)


def test_model_without_calibration_is_unchanged():
    model = load_model("so101")
    own = calibrated_model(model)
    assert own.model is model
    assert own.file is None


@pytest.mark.parametrize("name", ["so101", "koch", "planar3"])
def test_calibrated_model_has_same_limits_as_opened_arm(name, monkeypatch):
    arm = make_mounted_arm(name, 4, spoiled=False)
    monkeypatch.setattr("ikservo.hardware.port.open_transport", lambda *_: reopened(arm))
    with arm.open_limp() as limp_arm:
        calibration = make_calibration(arm, limp_arm, WHEN)
        memory = {s.id: s.holds for joint in calibration.joints for s in joint.servos}
        limp_arm.save(CalibrationResult(calibration, memory))
    own = calibrated_model(load_model(name)).model
    with ikservo.open_arm(load_model(name), f"bench:{name}", collisions=False) as machine:
        tick = 2 * math.pi / 4096
        np.testing.assert_allclose(own.chain.lower_rad, machine.chain.lower_rad, atol=tick)
        np.testing.assert_allclose(own.chain.upper_rad, machine.chain.upper_rad, atol=tick)
        states = {state.name: state.limit_from for state in machine.where().joints}
    assert {joint.name: joint.limits.source for joint in own.joints} == states


def reopened(arm):
    arm.port.is_open = True
    return arm.port


def test_limit_set_by_user_applies_and_names_user_as_source():
    calibration = calibration_of("so101")
    joints = [
        joint.model_copy(update={"user_upper_deg": 10.0}) if joint.name == "elbow_flex" else joint
        for joint in calibration.joints
    ]
    save_calibration(calibration.model_copy(update={"joints": tuple(joints)}))
    limit = calibrated_model(load_model("so101")).model.joint("elbow_flex").limits.upper
    assert limit.value == pytest.approx(math.radians(10.0))
    assert limit.source == "user"


def test_calibrated_model_uses_touch_off_geometry():
    moved = CalibratedGeometry(
        touched=WHEN, touches=8, left_out=0, before_mm=5.0, after_mm=1.0,
        base_moved_mm=(0.0, 0.0, 7.0), base_turned_deg=(0.0, 0.0, 0.0),
        origins=(CalibratedOrigin(joint="elbow_flex", moved_mm=(0.0, 0.0, 3.0)),),
    )  # fmt: skip
    save_calibration(calibration_of("so101", geometry=moved))
    model = load_model("so101")
    q = model.chain_pose("home")
    here, described = (
        each.chain.forward(q)[:3, 3] for each in (calibrated_model(model).model, model)
    )
    assert 0.003 < float(np.linalg.norm(here - described)) < 0.011


def test_touch_off_base_correction_applies_to_any_tip_link():
    moved = CalibratedGeometry(
        touched=WHEN, touches=8, left_out=0, before_mm=5.0, after_mm=1.0,
        base_moved_mm=(0.0, 0.0, 7.0), base_turned_deg=(0.0, 0.0, 0.0),
        origins=(CalibratedOrigin(joint="wrist_flex", moved_mm=(0.0, 0.0, 3.0)),),
    )  # fmt: skip
    save_calibration(calibration_of("so101", geometry=moved))
    path = CONFIGS / "so101" / "arm.toml"
    forearm = calibrated_model(ikservo.load_model(path, "forearm")).model.chain
    described = ikservo.load_model(path, "forearm").chain
    lift = forearm.forward(forearm.mid_range()) - described.forward(forearm.mid_range())
    assert lift[2, 3] == pytest.approx(0.007)


def test_newest_of_several_calibrations_is_used():
    save_calibration(calibration_of("so101", usb_serial_number="OLD1"))
    newest = save_calibration(
        calibration_of("so101", usb_serial_number="A2", written=WHEN + timedelta(days=1))
    )
    save_calibration(calibration_of("so101", usb_serial_number="OLD3"))
    own = calibrated_model(load_model("so101"))
    assert own.file == newest
    assert len(own.others) == 2
    assert "2026-11-03" in own.model.joint("elbow_flex").limits.source


def test_a_calibration_of_other_servos_is_refused():
    calibration = calibration_of("so101")
    first = calibration.joints[0]
    other = first.model_copy(update={"servo": first.servo.model_copy(update={"id": 9})})
    save_calibration(calibration.model_copy(update={"joints": (other, *calibration.joints[1:])}))
    with pytest.raises(CalibrationError, match="id 9"):
        calibrated_model(load_model("so101"))


def test_damaged_calibration_is_refused():
    path = save_calibration(calibration_of("so101"))
    path.write_text(path.read_text().replace("2026", "2025"))
    with pytest.raises(FileFormatError):
        calibrated_model(load_model("so101"))


def test_plain_urdf_has_no_calibration():
    save_calibration(calibration_of("so101"))
    bare = ikservo.load_model(CONFIGS / "so101" / "arm.urdf", "gripper_frame")
    assert calibrated_model(bare).model is bare

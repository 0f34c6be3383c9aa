"""The file of an identified arm is read as written, or refused with the place of the error."""

import math
from datetime import UTC, datetime

import pytest
from pydantic import ValidationError

from ikservo.calibration.identified_file import (
    IdentifiedArm,
    IdentifiedJoint,
    dump_identified,
    load_identified,
    read_identified,
    save_identified,
)
from ikservo.calibration.paths import identified_of, identified_path
from ikservo.errors import FileFormatError

JOINT = {
    "name": "elbow", "mass_scale": 1.1, "stiffness_nm_rad": 20.0, "p_gain": 16,
    "full_duty_nm": 2.9, "back_emf_nm_s": 0.4, "viscous_nm_s": 0.05, "coulomb_nm": 0.1,
    "load": 0.2, "slow_nm": 0.03, "slow_load": 0.1, "slow_rad_s": 0.2, "backlash_rad": 0.01,
    "errors": {"mass_scale": 0.02},
}  # fmt: skip


@pytest.fixture(autouse=True)
def home(tmp_path, monkeypatch):
    monkeypatch.setenv("IKSERVO_HOME", str(tmp_path))
    return tmp_path


def identified_arm(*joints, serial="58FA"):
    return IdentifiedArm(
        format=1,
        arm="so101",
        written=datetime(2026, 11, 2, 10, 0, tzinfo=UTC),
        tool_version="0.1.0",
        usb_serial_number=serial,
        joints=tuple(IdentifiedJoint(**(JOINT | joint)) for joint in joints or [{}]),
    )


def test_identified_arm_file_survives_save_and_read(home):
    arm = identified_arm({}, {"name": "wrist", "p_gain": None, "backlash_rad": None})
    path = save_identified(arm)
    assert path == identified_path("so101", "58FA") == home / "identified" / "so101-58FA.toml"
    assert read_identified(path) == load_identified("so101", "58FA") == arm
    assert "p_gain" not in path.read_text().partition('name = "wrist"')[2]
    assert identified_of("so101") == [path]


def test_load_of_missing_identified_file_returns_none():
    assert load_identified("so101", "58FA") is None
    assert identified_of("so101") == []


def test_previous_identified_file_is_kept():
    path = save_identified(identified_arm())
    before = path.read_text()
    save_identified(identified_arm({"mass_scale": 2.0}))
    kept = [each for each in path.parent.iterdir() if each != path]
    assert [each.read_text() for each in kept] == [before]


def test_identified_joint_is_found_by_its_name():
    arm = identified_arm({}, {"name": "wrist", "mass_scale": 2.0})
    assert arm.joint("wrist") == arm.joints[1]
    assert arm.joint("gripper") is None


@pytest.mark.parametrize(
    ("key", "inside", "outside"),
    [
        ("mass_scale", (1e-9, 1.0, 10.0), (0.0, -1.0, 10.001, math.nan)),
        ("p_gain", (0, 254), (-1, 1.5)),
        ("stiffness_nm_rad", (1e-9, 1000.0), (0.0, 1000.1)),
        ("coulomb_nm", (0.0, 1000.0), (-1e-9, 1000.1)),
        ("load", (0.0, 0.499), (-1e-9, 0.5)),
        ("slow_rad_s", (1e-9, 100.0), (0.0, 100.1)),
        ("backlash_rad", (0.0, 0.2), (-1e-9, 0.201)),
    ],
)
def test_identified_values_outside_their_ranges_are_refused(key, inside, outside):
    for value in inside:
        assert getattr(identified_arm({key: value}).joints[0], key) == value
    for value in outside:
        with pytest.raises(ValidationError):
            identified_arm({key: value})


def test_identification_file_needs_at_least_one_joint():
    tables = identified_arm().model_dump()
    assert IdentifiedArm.model_validate(tables).joints == identified_arm().joints
    with pytest.raises(ValidationError):
        IdentifiedArm.model_validate({**tables, "joints": ()})


def test_damaged_identification_file_is_refused(home):
    path = home / "arm.toml"
    path.write_text(dump_identified(identified_arm()).replace("1.1", "1.2", 1))
    with pytest.raises(FileFormatError):
        read_identified(path)


def test_identified_file_with_wrong_value_names_its_key(home):
    path = home / "arm.toml"
    path.write_text(dump_identified(identified_arm().model_copy(update={"arm": "so 101"})))
    with pytest.raises(FileFormatError, match="arm: is"):
        read_identified(path)


def test_identified_file_error_names_joint_listed_twice(home):
    path = home / "arm.toml"
    path.write_text(dump_identified(identified_arm({}, {"name": "wrist"}, {})))
    with pytest.raises(FileFormatError, match=r"joints\[2\]\.name.*elbow"):
        read_identified(path)

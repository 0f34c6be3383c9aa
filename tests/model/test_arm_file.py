"""An arm.toml is read as written."""

from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import ValidationError

from ikservo.model.arm_file import read_arm_file
from ikservo.model.arm_schema import ArmFile


@pytest.fixture
def arm(arm_path: Path) -> ArmFile:
    return read_arm_file(arm_path)


def test_arm_file_has_name_and_tip(arm: ArmFile) -> None:
    assert (arm.name, arm.tip) == ("small", "tip")


def test_urdf_path_is_in_folder_of_arm_file(arm: ArmFile, urdf_path: Path) -> None:
    assert arm.urdf_path == urdf_path


def test_arm_file_bus_has_servo_family_and_baud_rate(arm: ArmFile) -> None:
    assert (arm.bus.family, arm.bus.baud) == ("dynamixel_2", 1_000_000)


def test_arm_file_speed_classes_have_their_own_jerk(arm: ArmFile) -> None:
    speeds = arm.speeds
    assert (speeds.slow.deg_s3, speeds.normal.deg_s3, speeds.fast.deg_s3) == (600, 1200, 2400)


def test_model_joints_keep_order_of_arm_file(arm: ArmFile) -> None:
    assert [joint.name for joint in arm.joints] == ["shoulder", "elbow", "gripper"]


def test_arm_file_zero_tick_may_be_fractional(arm: ArmFile) -> None:
    assert arm.joints[0].servo.zero_tick == 2048.5


def test_integer_zero_tick_of_arm_file_is_read_as_float(arm: ArmFile) -> None:
    assert isinstance(arm.joints[1].servo.zero_tick, float)


def test_arm_file_eeprom_values_are_kept_as_written(arm: ArmFile) -> None:
    assert arm.joints[0].servo.eeprom == {"drive_mode": 0}


def test_secondary_servo_of_arm_file_belongs_to_its_joint(arm: ArmFile) -> None:
    assert [shadow.id for shadow in arm.joints[0].shadows] == [2]


def test_joint_with_metres_per_turn_is_prismatic(arm: ArmFile) -> None:
    assert [joint.is_prismatic for joint in arm.joints] == [False, False, True]


def test_arm_file_poses_keep_their_units(arm: ArmFile) -> None:
    assert (arm.poses["home"].deg["elbow"], arm.poses["home"].m["gripper"]) == (45.0, 0.01)


def test_arm_file_may_have_additional_poses(arm_path: Path, arm_text: str) -> None:
    wave = "[poses.wave]\ndeg = { shoulder = 9, elbow = 9 }\nm = { gripper = 0 }\n"
    arm_path.write_text(arm_text + wave)
    assert "wave" in read_arm_file(arm_path).poses


def test_arm_folder_outside_catalogue_may_have_any_name(arm_path: Path, tmp_path: Path) -> None:
    arm_path.parent.rename(tmp_path / "elsewhere")
    assert read_arm_file(tmp_path / "elsewhere" / "arm.toml").name == "small"


def test_arm_file_can_be_read_without_its_urdf(arm_path: Path, urdf_path: Path) -> None:
    urdf_path.unlink()
    assert not read_arm_file(arm_path).urdf_path.exists()


def test_arm_file_is_immutable(arm: ArmFile) -> None:
    with pytest.raises(ValidationError, match="frozen"):
        arm.tip = "base"  # type: ignore[misc]

"""Every arm in the catalogue is read without an error and without a warning."""

from __future__ import annotations

import pytest

from ikservo.model.arm_file import read_arm_file
from ikservo.model.catalogue import arm_names, find_arm
from ikservo.model.urdf import read_urdf
from ikservo.model.urdf_types import Urdf, UrdfJointType


def urdf_of(name: str) -> Urdf:
    return read_urdf(read_arm_file(find_arm(name)).urdf_path)


def test_arm_catalogue_is_not_empty() -> None:
    assert arm_names()


@pytest.mark.parametrize("name", arm_names())
def test_shipped_urdf_has_no_warnings(name: str) -> None:
    assert urdf_of(name).warnings == ()


@pytest.mark.parametrize("name", arm_names())
def test_joints_between_base_and_tip_are_the_arm_file_joints(name: str) -> None:
    arm = read_arm_file(find_arm(name))
    moving = [joint.name for joint in urdf_of(name).joints_to(arm.tip) if joint.kind.is_movable]
    assert moving == [joint.name for joint in arm.joints if joint.role == "arm"]


@pytest.mark.parametrize("name", arm_names())
def test_only_prismatic_joints_have_metres_per_turn(name: str) -> None:
    prismatic = {j.name for j in urdf_of(name).joints if j.kind is UrdfJointType.PRISMATIC}
    arm = read_arm_file(find_arm(name))
    assert all(joint.is_prismatic == (joint.name in prismatic) for joint in arm.joints)

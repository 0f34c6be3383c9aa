"""A URDF is read according to its specification."""

from __future__ import annotations

import math
import subprocess
import sys
from pathlib import Path

import pytest

from ikservo.errors import FileFormatError, UnknownNameError
from ikservo.model.urdf import read_urdf
from ikservo.model.urdf_types import (
    Box,
    Cylinder,
    Mesh,
    Sphere,
    Urdf,
    UrdfJoint,
    UrdfJointType,
    UrdfMimic,
)


@pytest.fixture
def urdf(urdf_path: Path) -> Urdf:
    return read_urdf(urdf_path)


def joint(urdf: Urdf, name: str) -> UrdfJoint:
    return next(joint for joint in urdf.joints if joint.name == name)


def test_urdf_robot_has_its_name(urdf: Urdf) -> None:
    assert urdf.name == "small"


def test_urdf_robot_name_may_be_missing(urdf_path: Path, urdf_text: str) -> None:
    urdf_path.write_text(urdf_text.replace(' name="small"', ""))
    assert read_urdf(urdf_path).name == ""


def test_urdf_root_is_link_without_parent(urdf: Urdf) -> None:
    assert urdf.root == "base"


def test_urdf_joints_to_link_are_listed_from_root(urdf: Urdf) -> None:
    assert [j.name for j in urdf.joints_to("tip")] == ["shoulder", "elbow", "roll", "tool"]


def test_urdf_root_link_has_no_joints_towards_it(urdf: Urdf) -> None:
    assert urdf.joints_to("base") == ()


def test_unknown_urdf_link_error_suggests_closest_name(urdf: Urdf) -> None:
    with pytest.raises(UnknownNameError, match="Did you mean tip"):
        urdf.joints_to("tipp")


def test_urdf_joint_origin_is_read(urdf: Urdf) -> None:
    assert (joint(urdf, "tool").xyz_m, joint(urdf, "tool").rpy_rad) == ((0, 0, 0.1), (0, 1.5, 0))


def test_urdf_joint_without_origin_is_at_its_parent(urdf: Urdf) -> None:
    assert (joint(urdf, "roll").xyz_m, joint(urdf, "roll").rpy_rad) == ((0, 0, 0), (0, 0, 0))


def test_urdf_origin_without_rpy_has_no_rotation(urdf: Urdf) -> None:
    assert joint(urdf, "elbow").rpy_rad == (0, 0, 0)


def test_urdf_origin_without_xyz_is_at_its_parent(urdf_path: Path, urdf_text: str) -> None:
    urdf_path.write_text(urdf_text.replace('xyz="0 0 0.1" rpy="0 1.5 0"', 'rpy="0 1.5 0"'))
    tool = joint(read_urdf(urdf_path), "tool")
    assert (tool.xyz_m, tool.rpy_rad) == ((0, 0, 0), (0, 1.5, 0))


def test_urdf_joint_axis_is_normalised(urdf: Urdf) -> None:
    assert joint(urdf, "elbow").axis == pytest.approx((0, 0.6, 0.8), abs=1e-15)


def test_urdf_joint_axis_of_huge_numbers_is_normalised(urdf_path: Path, urdf_text: str) -> None:
    urdf_path.write_text(urdf_text.replace("0 3 4", "0 3e307 4e307"))
    assert joint(read_urdf(urdf_path), "elbow").axis == pytest.approx((0, 0.6, 0.8), abs=1e-15)


def test_urdf_joint_without_axis_turns_about_x(urdf: Urdf) -> None:
    assert joint(urdf, "roll").axis == (1, 0, 0)


def test_urdf_fixed_joint_may_have_axis_of_zero_length(urdf: Urdf) -> None:
    assert joint(urdf, "tool").kind is UrdfJointType.FIXED


def test_urdf_fixed_joint_is_not_movable(urdf: Urdf) -> None:
    assert not joint(urdf, "tool").kind.is_movable


@pytest.mark.parametrize("name", ["elbow", "roll", "gripper"])
def test_urdf_joint_that_is_not_fixed_is_movable(urdf: Urdf, name: str) -> None:
    assert joint(urdf, name).kind.is_movable


def test_urdf_joint_limits_are_read(urdf: Urdf) -> None:
    elbow = joint(urdf, "elbow")
    assert (elbow.lower, elbow.upper, elbow.effort, elbow.velocity) == (-1.5, 2.5, 1.9, 4.0)


@pytest.mark.parametrize("limits", ['effort="-1" velocity="4"', 'effort="1" velocity="-4"'])
def test_negative_urdf_effort_or_velocity_is_refused(
    urdf_path: Path, urdf_text: str, limits: str
) -> None:
    urdf_path.write_text(urdf_text.replace('effort="1.9" velocity="4"', limits))
    with pytest.raises(FileFormatError, match=r"line \d+: has (effort|velocity) -"):
        read_urdf(urdf_path)


def test_continuous_joint_has_infinite_limits(urdf: Urdf) -> None:
    roll = joint(urdf, "roll")
    assert (roll.lower, roll.upper) == (-math.inf, math.inf)


def test_missing_urdf_lower_limit_is_zero(urdf_path: Path, urdf_text: str) -> None:
    urdf_path.write_text(urdf_text.replace('lower="-1.5" ', ""))
    assert joint(read_urdf(urdf_path), "elbow").lower == 0


def test_missing_urdf_effort_limit_is_infinite(urdf_path: Path, urdf_text: str) -> None:
    urdf_path.write_text(urdf_text.replace(' effort="1.9"', ""))
    assert joint(read_urdf(urdf_path), "elbow").effort == math.inf


def test_urdf_mimic_offset_is_zero_by_default(urdf: Urdf) -> None:
    assert joint(urdf, "other_finger").mimic == UrdfMimic("gripper", multiplier=-1, offset=0)


def test_urdf_joint_has_its_line_number(urdf: Urdf) -> None:
    assert joint(urdf, "elbow").line == 10


def test_urdf_link_has_mass_and_centre_of_mass(urdf: Urdf) -> None:
    assert (urdf.link("base").mass_kg, urdf.link("base").com_m) == (0.5, (0, 0, 0.05))


def test_urdf_inertia_order_is_xx_xy_xz_yy_yz_zz(urdf: Urdf) -> None:
    assert urdf.link("base").inertia_kg_m2 == (1e-3, 0, 0, 2e-3, 0, 3e-3)


def test_urdf_link_without_inertial_has_no_mass(urdf: Urdf) -> None:
    assert urdf.link("tip").mass_kg == 0


def test_urdf_box_shape_has_its_edge_lengths(urdf: Urdf) -> None:
    assert urdf.link("base").collisions == (Box((0.1, 0.2, 0.3), (0, 0, 0), (0, 0, 0)),)


def test_urdf_cylinder_shape_has_radius_length_and_origin(urdf: Urdf) -> None:
    assert urdf.link("upper").collisions == (Cylinder(0.02, 0.2, (0.1, 0, 0), (0, 0, 0)),)


def test_urdf_sphere_shape_has_its_radius(urdf: Urdf) -> None:
    assert urdf.link("fore").collisions == (Sphere(0.03, (0, 0, 0), (0, 0, 0)),)


def test_mesh_in_urdf_folder_has_its_path(urdf: Urdf, urdf_path: Path) -> None:
    (mesh,) = urdf.link("base").visuals
    assert isinstance(mesh, Mesh)
    assert mesh.path == urdf_path.parent.resolve() / "meshes" / "base.stl"


def test_valid_urdf_gives_no_warnings(urdf: Urdf) -> None:
    assert urdf.warnings == ()


def test_urdf_byte_order_mark_is_ignored(urdf_path: Path, urdf_text: str) -> None:
    urdf_path.write_bytes(b"\xef\xbb\xbf" + urdf_text.encode())
    assert read_urdf(urdf_path).root == "base"


def test_urdf_limit_beyond_a_turn_warns_about_degrees(urdf_path: Path, urdf_text: str) -> None:
    urdf_path.write_text(urdf_text.replace('lower="-1.5" upper="2.5"', 'lower="-90" upper="2.5"'))
    assert read_urdf(urdf_path).warnings == (
        'line 10: joint "elbow" has lower -90 rad, more than a turn; '
        "if these are degrees, write -1.5708",
    )


def test_urdf_limit_of_rounded_full_turn_gives_no_warning(urdf_path: Path, urdf_text: str) -> None:
    urdf_path.write_text(urdf_text.replace('upper="2.5"', 'upper="6.28319"'))
    assert read_urdf(urdf_path).warnings == ()


def test_urdf_prismatic_limit_of_10_m_gives_no_warning(urdf_path: Path, urdf_text: str) -> None:
    urdf_path.write_text(urdf_text.replace('upper="0.02"', 'upper="10"'))
    assert read_urdf(urdf_path).warnings == ()


def test_urdf_rpy_beyond_a_turn_warns_about_degrees(urdf_path: Path, urdf_text: str) -> None:
    urdf_path.write_text(urdf_text.replace("0 1.5 0", "0 90 0"))
    assert read_urdf(urdf_path).warnings == (
        'line 4: joint "tool" has 90 rad in its rpy; if these are degrees, write 1.5708',
    )


def test_urdf_limits_of_continuous_joint_give_warning(urdf_path: Path, urdf_text: str) -> None:
    limited = '<child link="wrist"/><limit lower="-1" upper="1"/>'
    urdf_path.write_text(urdf_text.replace('<child link="wrist"/>', limited))
    assert read_urdf(urdf_path).warnings == (
        'line 25: joint "roll" is continuous and ignores its limits; type="revolute" keeps them',
    )


ALONE = """
import ikservo, pathlib, sys, types
model = sys.modules["ikservo.model"] = types.ModuleType("ikservo.model")
model.__path__ = [str(pathlib.Path(ikservo.__file__).parent / "model")]
import ikservo.model.urdf
print({"pydantic", "numpy"} & set(sys.modules))
"""


def test_urdf_reader_imports_neither_pydantic_nor_numpy() -> None:
    run = [sys.executable, "-c", ALONE]
    done = subprocess.run(run, capture_output=True, text=True, check=True)
    assert done.stdout == "set()\n"


COLOURED = """<robot name="r"><material name="steel"><color rgba="0.5 0.6 0.7 1"/></material>
<link name="base">
  <visual><geometry><sphere radius="1"/></geometry><material name="steel"/></visual>
  <visual><geometry><sphere radius="1"/></geometry><material name="steel"><color rgba="1 0 2 1"/></material></visual>
  <visual><geometry><sphere radius="1"/></geometry><material name="unknown"/></visual>
  <visual><geometry><sphere radius="1"/></geometry></visual>
  <visual><geometry><sphere radius="1"/></geometry><material name="odd"><color rgba="red"/></material></visual>
</link></robot>"""  # noqa: E501


def test_urdf_visual_has_valid_material_colour_or_none(
    urdf_path: Path,
) -> None:
    urdf_path.write_text(COLOURED)
    named, own = (0.5, 0.6, 0.7), (1.0, 0.0, 1.0)
    assert read_urdf(urdf_path).link("base").colours == (named, own, None, None, None)

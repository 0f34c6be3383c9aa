"""A small arm with all features: three turning joints, and a gripper that slides."""

from __future__ import annotations

from pathlib import Path

import pytest

URDF = """\
<?xml version="1.0"?>
<robot name="small">
  <material name="grey"/>
  <joint name="tool" type="fixed">
    <parent link="wrist"/>
    <child link="tip"/>
    <origin xyz="0 0 0.1" rpy="0 1.5 0"/>
    <axis xyz="0 0 0"/>
  </joint>
  <joint name="elbow" type="revolute">
    <parent link="upper"/>
    <child link="fore"/>
    <origin xyz="0.2 0 0"/>
    <axis xyz="0 3 4"/>
    <limit lower="-1.5" upper="2.5" effort="1.9" velocity="4"/>
  </joint>
  <joint name="shoulder" type="revolute">
    <parent link="base"/>
    <child link="upper"/>
    <axis xyz="0 1 0"/>
    <limit lower="-1" upper="1" effort="2" velocity="4"/>
  </joint>
  <joint name="roll" type="continuous">
    <parent link="fore"/>
    <child link="wrist"/>
  </joint>
  <joint name="gripper" type="prismatic">
    <parent link="wrist"/>
    <child link="finger"/>
    <axis xyz="0 1 0"/>
    <limit lower="0" upper="0.02" effort="5" velocity="0.1"/>
  </joint>
  <joint name="other_finger" type="prismatic">
    <parent link="wrist"/>
    <child link="thumb"/>
    <axis xyz="0 1 0"/>
    <limit lower="-0.02" upper="0" effort="5" velocity="0.1"/>
    <mimic joint="gripper" multiplier="-1"/>
  </joint>
  <link name="base">
    <inertial>
      <origin xyz="0 0 0.05"/>
      <mass value="0.5"/>
      <inertia ixx="1e-3" ixy="0" ixz="0" iyy="2e-3" iyz="0" izz="3e-3"/>
    </inertial>
    <visual><geometry><mesh filename="meshes/base.stl"/></geometry></visual>
    <collision><geometry><box size="0.1 0.2 0.3"/></geometry></collision>
  </link>
  <link name="upper">
    <collision>
      <origin xyz="0.1 0 0"/>
      <geometry><cylinder radius="0.02" length="0.2"/></geometry>
    </collision>
  </link>
  <link name="fore"><collision><geometry><sphere radius="0.03"/></geometry></collision></link>
  <link name="wrist"/>
  <link name="finger"/>
  <link name="thumb"/>
  <link name="tip"/>
  <gazebo><anything/></gazebo>
</robot>
"""

ARM = """\
format = 1
name = "small"
title = "A small arm"
urdf = "arm.urdf"
tip = "tip"
source = "made up"

[bus]
family = "dynamixel_2"
baud = 1_000_000

[speeds]
slow = { deg_s = 30.0, deg_s2 = 60.0, deg_s3 = 600.0 }
normal = { deg_s = 60.0, deg_s2 = 120.0, deg_s3 = 1200.0 }
fast = { deg_s = 90.0, deg_s2 = 240.0, deg_s3 = 2400.0 }

[[joints]]
name = "shoulder"
role = "arm"
zero_from = "nominal"
servo = { id = 1, model = "XM430-W350", sign = -1, zero_tick = 2048.5, eeprom = { drive_mode = 0 } }
shadows = [{ id = 2, model = "XM430-W350", sign = 1, zero_tick = 2048 }]

[[joints]]
name = "elbow"
role = "arm"
zero_from = "vendor"
servo = { id = 3, model = "XM430-W350", sign = 1, zero_tick = 1024 }

[[joints]]
name = "gripper"
role = "gripper"
zero_from = "vendor"
servo = { id = 4, model = "XL430-W250", sign = 1, zero_tick = 2048, m_per_turn = 0.0722 }

[poses.rest]
deg = { shoulder = -57.0, elbow = 100.0 }
m = { gripper = 0.0 }

[poses.home]
deg = { shoulder = 0.0, elbow = 45.0 }
m = { gripper = 0.01 }

[poses.zero]
deg = { shoulder = 0.0, elbow = 0.0 }
m = { gripper = 0.0 }
"""


@pytest.fixture(scope="session")
def urdf_text() -> str:
    return URDF


@pytest.fixture(scope="session")
def arm_text() -> str:
    return ARM


@pytest.fixture
def urdf_path(tmp_path: Path) -> Path:
    path = tmp_path / "small" / "arm.urdf"
    path.parent.mkdir()
    path.write_text(URDF)
    return path


@pytest.fixture
def arm_path(urdf_path: Path) -> Path:
    path = urdf_path.parent / "arm.toml"
    path.write_text(ARM)
    return path

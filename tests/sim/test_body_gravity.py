"""Gravity, masses and velocity forces of an arm, compared with MuJoCo and with hand results."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import pytest
from numpy.typing import NDArray

from servosim.dynamics import RigidArm
from servosim.errors import ArmFileError

Array = NDArray[np.float64]

CONFIGS = sorted((Path(__file__).parents[2] / "configs").glob("*/arm.urdf"))

# Tilted axes, a branch, a fixed mass, a sliding joint, inertias off their principal axes.
CRANKED = """<robot name="cranked">
  <link name="base"><inertial><mass value="5"/><inertia ixx="1" iyy="1" izz="1"
    ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="pan" type="revolute"><parent link="base"/><child link="a"/>
    <origin xyz="0.1 0.2 0.3" rpy="0.4 -0.2 1.1"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <link name="a"><inertial><origin xyz="0.02 0.05 -0.03" rpy="0.3 0.1 0.2"/><mass value="0.4"/>
    <inertia ixx="0.002" iyy="0.003" izz="0.004" ixy="0.0002" ixz="0.0001" iyz="0.0003"/>
  </inertial></link>
  <joint name="mount" type="fixed"><parent link="a"/><child link="b"/>
    <origin xyz="0.1 0 0.05" rpy="0 0.5 0"/></joint>
  <link name="b"><inertial><origin xyz="0.01 0 0.04"/><mass value="0.25"/>
    <inertia ixx="0.001" iyy="0.0012" izz="0.0008" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="lift" type="revolute"><parent link="b"/><child link="c"/>
    <origin xyz="0.2 0.03 0" rpy="1.2 0 -0.7"/><axis xyz="1 2 -2"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <link name="c"><inertial><origin xyz="0.1 0 0.02"/><mass value="0.3"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="slide" type="prismatic"><parent link="c"/><child link="d"/>
    <origin xyz="0.15 0 0" rpy="0.2 0.9 0"/><axis xyz="0.3 0.1 -1"/>
    <limit lower="0" upper="0.1" effort="1" velocity="1"/></joint>
  <link name="d"><inertial><origin xyz="0 0.01 0.05"/><mass value="0.15"/>
    <inertia ixx="0.0005" iyy="0.0005" izz="0.0005" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="branch" type="revolute"><parent link="a"/><child link="e"/>
    <origin xyz="-0.1 0 0.1" rpy="0 -1.1 0.3"/><axis xyz="0 0 1"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/></joint>
  <link name="e"><inertial><origin xyz="0.2 0 0"/><mass value="0.2"/>
    <inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial></link>
</robot>"""
CRANKED_JOINTS = ("pan", "lift", "slide", "branch")

PENDULUM = """<robot name="pendulum"><link name="base"/>
  <joint name="swing" type="revolute"><parent link="base"/><child link="bob"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <link name="bob"><inertial><origin xyz="0.2 0 0"/><mass value="0.5"/></inertial></link>
  {more}</robot>"""


def write(folder: Path, text: str) -> Path:
    path = folder / "arm.urdf"
    path.write_text(text)
    return path


def mujoco_model(path: Path) -> mujoco.MjModel:
    """Return the same file in MuJoCo without geometry: only masses and joints are compared."""
    spec = mujoco.MjSpec.from_file(str(path))
    spec.compiler.discardvisual = 1
    spec.compiler.balanceinertia = 1
    spec.option.gravity = (0.0, 0.0, -9.81)
    return spec.compile()


def driven_joints(model: mujoco.MjModel) -> tuple[str, ...]:
    return tuple(model.joint(k).name for k in range(model.njnt))


def poses(body: RigidArm, count: int) -> list[list[float]]:
    rng = np.random.default_rng(7)
    limits = np.clip(np.array(body.limits), -math.pi, math.pi)
    return [list(rng.uniform(limits[:, 0], limits[:, 1])) for _ in range(count)]


def mujoco_state(model: mujoco.MjModel, names: tuple[str, ...], q: list[float]) -> mujoco.MjData:
    data = mujoco.MjData(model)
    for name, position in zip(names, q, strict=True):
        data.joint(name).qpos[0] = position
    mujoco.mj_forward(model, data)
    return data


def mass_matrix(model: mujoco.MjModel, data: mujoco.MjData, names: Sequence[str]) -> Array:
    """Return the mass matrix of these joints, in this order."""
    columns = [int(model.joint(name).dofadr[0]) for name in names]
    M = np.zeros((model.nv, model.nv))
    for unit, row in zip(np.eye(model.nv), M, strict=True):
        mujoco.mj_mulM(model, data, row, unit)
    return M[np.ix_(columns, columns)]


def test_gravity_of_cranked_branching_arm_equals_mujoco(tmp_path: Path) -> None:
    path = write(tmp_path, CRANKED)
    body, model = RigidArm(path, CRANKED_JOINTS), mujoco_model(path)
    for q in poses(body, 50):
        data = mujoco_state(model, CRANKED_JOINTS, q)
        expected = [-data.joint(name).qfrc_bias[0] for name in CRANKED_JOINTS]
        assert body.load_nm(q, [0.0] * 4) == pytest.approx(expected, abs=1e-9)


def test_mass_matrix_of_cranked_branching_arm_equals_mujoco(tmp_path: Path) -> None:
    path = write(tmp_path, CRANKED)
    body, model = RigidArm(path, CRANKED_JOINTS), mujoco_model(path)
    for q in poses(body, 10):
        data = mujoco_state(model, CRANKED_JOINTS, q)
        expected = mass_matrix(model, data, CRANKED_JOINTS)
        assert np.array(body.mass_matrix(q)) == pytest.approx(expected, abs=1e-9)


def test_coriolis_forces_of_cranked_arm_equal_mujoco(tmp_path: Path) -> None:
    path = write(tmp_path, CRANKED)
    body, model = RigidArm(path, CRANKED_JOINTS), mujoco_model(path)
    rng = np.random.default_rng(8)
    for q in poses(body, 20):
        data, v = mujoco_state(model, CRANKED_JOINTS, q), rng.normal(size=4)
        for name, velocity in zip(CRANKED_JOINTS, v, strict=True):
            data.joint(name).qvel[0] = velocity
        mujoco.mj_forward(model, data)
        expected = [-data.joint(name).qfrc_bias[0] for name in CRANKED_JOINTS]
        assert body.load_nm(q, v.tolist()) == pytest.approx(expected, abs=1e-9)


@pytest.mark.parametrize("path", CONFIGS, ids=lambda path: path.parent.name)
def test_gravity_of_every_shipped_arm_equals_mujoco(path: Path) -> None:
    model = mujoco_model(path)
    names = driven_joints(model)
    body = RigidArm(path, names)
    for q in poses(body, 10):
        data = mujoco_state(model, names, q)
        expected = [-data.joint(name).qfrc_bias[0] for name in names]
        assert body.load_nm(q, [0.0] * len(names)) == pytest.approx(expected, abs=1e-6)


def test_simulated_level_pendulum_load_is_weight_times_length(tmp_path: Path) -> None:
    body = RigidArm(write(tmp_path, PENDULUM.format(more="")), ["swing"])
    assert body.load_nm([0.0], [0.0]) == pytest.approx([0.5 * 9.81 * 0.2])


def test_simulated_hanging_pendulum_has_no_load(tmp_path: Path) -> None:
    body = RigidArm(write(tmp_path, PENDULUM.format(more="")), ["swing"])
    assert body.load_nm([math.pi / 2], [0.0]) == pytest.approx([0.0], abs=1e-12)


def test_mimic_joint_adds_its_load_to_leader(tmp_path: Path) -> None:
    copy = """<joint name="copy" type="revolute"><parent link="base"/><child link="twin"/>
      <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="1" velocity="1"/>
      <mimic joint="swing" multiplier="2"/></joint>
      <link name="twin"><inertial><origin xyz="0.1 0 0"/><mass value="1"/></inertial></link>"""
    body = RigidArm(write(tmp_path, PENDULUM.format(more=copy)), ["swing"])
    swing_nm = 0.5 * 9.81 * 0.2 * math.cos(0.3)
    twin_nm = 2 * 1.0 * 9.81 * 0.1 * math.cos(0.6)
    assert body.load_nm([0.3], [0.0]) == pytest.approx([swing_nm + twin_nm])


def test_error_names_missing_joint_and_existing_joints(tmp_path: Path) -> None:
    path = write(tmp_path, PENDULUM.format(more=""))
    with pytest.raises(ArmFileError, match=r"no moving joint 'elbow'; has: swing"):
        RigidArm(path, ["elbow"])


def test_invalid_urdf_is_refused_with_its_name(tmp_path: Path) -> None:
    path = write(tmp_path, "<robot><joint type='revolute' name='a'/></robot>")
    with pytest.raises(ArmFileError, match=r"arm\.urdf"):
        RigidArm(path, ["a"])

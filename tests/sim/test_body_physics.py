"""The arm in MuJoCo: moving motor masses, gravity, contact with the floor."""

from __future__ import annotations

from pathlib import Path

import pytest

from servosim import open_port
from servosim.control import DriveCommand
from servosim.errors import ArmFileError
from servosim.motor import Motor
from servosim.mujoco_body import MujocoBody
from servosim.parameters import PARAMETERS
from servosim.surroundings import Cube
from tests.oracle import CONFIGS, tip_from_joints

SO101 = Path(__file__).parents[2] / "configs" / "so101" / "arm.urdf"
JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll", "gripper")
STS = PARAMETERS["STS3215"]

# A rod of 0.3 m that turns 0.1 m above the floor.
ROD = """<robot name="rod"><link name="base"/>
  <joint name="swing" type="revolute"><parent link="base"/><child link="rod"/>
    <origin xyz="0 0 0.1"/><axis xyz="0 1 0"/>
    <limit lower="-3" upper="3" effort="1" velocity="1"/></joint>
  <link name="rod"><inertial><origin xyz="0.15 0 0"/><mass value="0.5"/>
    <inertia ixx="0.001" iyy="0.004" izz="0.004" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0.15 0 0"/><geometry><box size="0.3 0.02 0.02"/></geometry>
    </collision></link></robot>"""


# A light crank that drives two fingers, 20 mm per rad, over a table.
FINGER = """
  <joint name="{side}" type="prismatic"><parent link="palm"/><child link="{side}"/>
    <origin xyz="0 0 0.0175"/><axis xyz="0 {sign} 0"/><mimic joint="crank" multiplier="0.02"
    offset="0.02"/><limit lower="0.01" upper="0.04" effort="9" velocity="1"/></joint>
  <link name="{side}"><inertial><origin xyz="0 {inner} 0"/><mass value="0.016"/>
    <inertia ixx="3e-6" iyy="3e-6" izz="3e-6" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 {inner} 0"/><geometry><box size="0.04 0.01 0.02"/></geometry>
    </collision></link>"""
CRANKED = f"""<robot name="cranked"><link name="palm"/>
  <joint name="crank" type="revolute"><parent link="palm"/><child link="crank"/>
    <origin xyz="0 0 0.1"/><axis xyz="0 0 1"/>
    <limit lower="-0.5" upper="1" effort="1" velocity="3"/></joint>
  <link name="crank"><inertial><mass value="0.004"/>
    <inertia ixx="1e-7" iyy="1e-7" izz="4e-7" ixy="0" ixz="0" iyz="0"/></inertial></link>
  {FINGER.format(side="left", sign="1", inner="0.005")}
  {FINGER.format(side="right", sign="-1", inner="-0.005")}</robot>"""


def rod(folder: Path) -> MujocoBody:
    path = folder / "rod.urdf"
    path.write_text(ROD)
    return MujocoBody(path, ["swing"], [[STS]])


def run(body: MujocoBody, motors: list[Motor], drive: DriveCommand, seconds: float) -> None:
    for motor in motors:
        motor.carried = True
    for _ in range(round(seconds / 0.001)):
        for motor in motors:
            motor.step(0.001, 0.0, drive, 7.4)
        states = body.step(0.001, [motor.torque_nm for motor in motors], {})
        for motor, state in zip(motors, states, strict=True):
            motor.set_state(*state)


def test_simulated_limp_rod_falls_onto_floor_and_stays(tmp_path: Path) -> None:
    body, motor = rod(tmp_path), Motor(STS)
    run(body, [motor], DriveCommand(), 3.0)
    assert body.contacts > 0
    assert motor.position_rad == pytest.approx(0.305, abs=0.01)  # sin = (0.1 - 0.01 cos) / 0.3


def test_simulated_rod_sags_by_torque_over_stiffness(tmp_path: Path) -> None:
    body, motor = rod(tmp_path), Motor(STS)
    run(body, [motor], DriveCommand(torque_on=True), 3.0)
    load_nm = 0.5 * 9.81 * 0.15
    held_nm = -motor.position_rad * 5.3 * STS.duty_torque_nm
    dry_nm = STS.friction_nm + STS.stribeck_nm
    dry_nm += (STS.load_friction + STS.load_stribeck) * abs(held_nm - load_nm)
    assert abs(held_nm + load_nm) <= dry_nm


def test_so101_in_mujoco_reaches_pose_with_all_joints_moving() -> None:
    body, motors = MujocoBody(SO101, JOINTS, [[STS]] * 6), [Motor(STS) for _ in JOINTS]
    drive = DriveCommand(True, goal_rad=0.3, velocity_limit_rad_s=1.0, acceleration_rad_s2=4.0)
    run(body, motors, drive, 2.0)
    assert [m.position_rad for m in motors] == pytest.approx([0.3] * 6, abs=0.05)


def test_joint_missing_in_urdf_raises_arm_file_error(tmp_path: Path) -> None:
    path = tmp_path / "rod.urdf"
    path.write_text(ROD)
    with pytest.raises(ArmFileError, match="elbow"):
        MujocoBody(path, ["elbow"], [[STS]])


def test_prismatic_joint_in_mujoco_reaches_goal_through_rack() -> None:
    port = open_port(f"sim:{CONFIGS}/open_manipulator_x/arm.toml?pose=home&physics=1")
    servo, world = port.line.servos[15], port.line.world
    servo.write("goal_position", servo.read("present_position") - 100)
    servo.write("torque_enable", 1)
    world.advance_to(1.0)
    assert servo.read("present_position") == pytest.approx(servo.read("goal_position"), abs=3)


def test_mujoco_floor_is_at_table_height_of_arm_file() -> None:
    port = open_port(f"sim:{CONFIGS}/open_manipulator_x/arm.toml?pose=home&physics=1")
    port.line.world.advance_to(3.0)
    joints = {joint.name: joint.position for joint in port.line.world.joints}
    assert -0.017 < tip_from_joints("open_manipulator_x", joints)[2] < 0.005


def test_mujoco_link_has_no_contact_with_its_own_base() -> None:
    port = open_port(f"sim:{CONFIGS}/koch/arm.toml?pose=home&physics=1")
    pan = port.line.servos[1]
    pan.write("torque_enable", 1)
    pan.write("goal_position", pan.read("present_position") + 100)
    port.line.world.advance_to(1.0)
    assert pan.read("present_position") == pytest.approx(pan.read("goal_position"), abs=5)


def test_mujoco_rotor_rests_while_output_crosses_backlash(tmp_path: Path) -> None:
    body = rod(tmp_path)
    for _ in range(12):
        position, _, lash, rotor = body.step(0.001, [0.0], {})[0]
        assert abs(rotor) < 1e-4
    assert 0.001 < position < STS.backlash_rad / 2.0
    assert lash == pytest.approx(position, abs=1e-6)


def test_mujoco_and_built_in_dynamics_agree_on_rest_position() -> None:
    states: list[list[tuple[float, float]]] = []
    for option in ("", "&physics=1"):
        port = open_port(f"sim:{CONFIGS}/so101/arm.toml?pose=home{option}")
        world = port.line.world
        for servo in world.servos:
            servo.write("torque_enable", 1)
        world.advance_to(1.0)
        motors = [joint.servos[0].motor for joint in world.joints]
        states.append([(motor.position_rad, motor.lash_rad) for motor in motors])
    for (own, own_lash), (theirs, lash) in list(zip(*states, strict=True))[1:4]:  # weight on them
        assert theirs == pytest.approx(own, abs=0.001)
        assert lash == pytest.approx(own_lash, abs=1e-5)
        assert abs(own_lash) == STS.backlash_rad / 2.0


def test_geared_fingers_hold_cube_under_load(tmp_path: Path) -> None:
    path = tmp_path / "cranked.urdf"
    path.write_text(CRANKED)
    body = MujocoBody(path, ["crank"], [[STS]], cubes=[Cube("red", 0.0, 0.0)])
    body.place([0.5])
    for _ in range(2000):
        body.step(0.001, [-0.5], {})
    fingers_m = [float(body._data.joint(side).qpos[0]) for side in ("left", "right")]
    crank = float(body._data.joint("crank").qpos[0])
    assert fingers_m == pytest.approx([0.0175, 0.0175], abs=0.0012)
    assert fingers_m == pytest.approx([0.02 * crank + 0.02] * 2, abs=1e-5)
    ((_, y_m, z_m),) = (T[:3, 3] for T in body.cube_poses())
    assert (y_m, z_m) == pytest.approx((0.0, 0.0175), abs=0.001)

"""Load the model of an arm from its arm file and its URDF."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from ikservo.arguments import parse_name
from ikservo.calibration import Crank, JointMap, Limits, format_position
from ikservo.errors import FileFormatError, InputError
from ikservo.kinematics import Chain, Joint, JointType, Mimic
from ikservo.kinematics.se3 import make_pose, rotation_rpy
from ikservo.model.arm_file import read_arm_file
from ikservo.model.arm_model import (
    Gripper,
    HealthLimits,
    KeepOutBox,
    Model,
    ModelJoint,
    ModelServo,
    SpeedClass,
)
from ikservo.model.arm_schema import ArmFile, ArmGripper, ArmJoint, ArmPose
from ikservo.model.base_placement import parse_frame, turn_base
from ikservo.model.catalogue import find_arm
from ikservo.model.urdf import read_urdf, read_urdf_text
from ikservo.model.urdf_types import Mesh, Urdf, UrdfJoint, UrdfJointType
from ikservo.model.urdf_xml import import_command, is_mjcf
from ikservo.registers import MODELS, ControlTable, Family

_KINDS = {
    UrdfJointType.FIXED: JointType.FIXED,
    UrdfJointType.REVOLUTE: JointType.REVOLUTE,
    UrdfJointType.CONTINUOUS: JointType.REVOLUTE,
    UrdfJointType.PRISMATIC: JointType.PRISMATIC,
}


def build_chain(urdf: Urdf, tip: str) -> Chain:
    """Build the chain from the URDF's root to a link.

    Raises:
        UnknownNameError: The URDF has no such link.
        InputError: No joint moves the link.
    """
    joints = [
        Joint(
            name=joint.name,
            kind=_KINDS[joint.kind],
            parent=joint.parent,
            child=joint.child,
            origin=make_pose(joint.xyz_m, rotation_rpy(*joint.rpy_rad)),
            axis=np.array(joint.axis),
            lower=joint.lower,
            upper=joint.upper,
            mimic=joint.mimic
            and Mimic(joint.mimic.joint, joint.mimic.multiplier, joint.mimic.offset),
        )
        for joint in urdf.joints
    ]
    return Chain.from_joints(joints, urdf.root, tip)


MAX_LINKS, MAX_MOVING_JOINTS = 200, 100
"""Largest numbers of links and moving joints in a description.

The cost of Jacobians grows with the square of the number of joints, that of mass matrices with the
cube. The number of link pairs that are checked for collisions grows with the square of the number
of links; each pair takes longer if there are more joints between its links.
"""


def read_description(path: Path, folder: Path | None = None) -> Urdf:
    """Read a URDF of limited size; other descriptions must be converted once by ``arms new``.

    Raises:
        FileFormatError: The file cannot be used; the place and the cause are named.
    """
    if path.suffix == ".xml" and is_mjcf(path):
        raise FileFormatError(path, "", "is an MJCF", f"a URDF; convert it: {import_command(path)}")
    urdf = read_urdf(path, folder)
    check_size(path, urdf)
    return urdf


def check_size(path: Path, urdf: Urdf) -> None:
    """Refuse a tree that has more links or joints than any arm.

    Raises:
        FileFormatError: The tree is too large.
    """
    moving = sum(joint.kind.is_movable for joint in urdf.joints)
    for count, most, what in (
        (len(urdf.links), MAX_LINKS, "links"),
        (moving, MAX_MOVING_JOINTS, "joints that move"),
    ):
        if count > most:
            raise FileFormatError(path, "", f"has {count:,} {what}", f"at most {most}")


def description_text(model: Model) -> str:
    """Return an arm's URDF as text.

    Raises:
        FileFormatError: A file has changed since it was loaded, and can no longer be read.
    """
    path = model.path
    if path.suffix == ".toml":
        path = read_arm_file(path).urdf_path
    return read_urdf_text(path)


_ARM_FILE = "arm file"


def load_model(arm: str | Path, tip: str | None = None) -> Model:
    """Load an arm.

    Args:
        arm: A name in the catalogue, or a path to an ``arm.toml``, to a folder with one, or to
            a ``.urdf``.
        tip: The link of the tool; None uses the tip in the arm file. Required for a plain URDF.

    Raises:
        UnknownNameError: There is no arm of that name; the closest name is suggested.
        FileFormatError: A file cannot be used; the place and the expected value are named.
    """
    if tip is not None:
        parse_name("The tip", tip)
    path = find_arm(arm)
    if path.suffix == ".toml":
        return _load_arm_model(path, tip)
    urdf = read_description(path)
    if tip is None:
        links = ", ".join(link.name for link in urdf.links)
        hint = f"Choose the tool link with tip (--tip): one of {links}."
        raise InputError(f"{path} does not say which link is the tool.", hint)
    name = urdf.name or path.stem
    return Model.from_geometry(name, name, build_chain(urdf, tip), urdf, path)


def _load_arm_model(path: Path, tip: str | None) -> Model:
    arm = read_arm_file(path)
    urdf = _read_tree(path, arm)
    joints = tuple(_make_model_joint(path, arm, i, urdf) for i in range(len(arm.joints)))
    _check_poses(path, joints, arm)
    return Model(
        name=arm.name,
        title=arm.title,
        chain=build_chain(urdf, tip or arm.tip),
        urdf=urdf,
        joints=joints,
        poses={name: _pose_positions(pose) for name, pose in arm.poses.items()},
        speeds={
            name: SpeedClass(*map(math.radians, (speed.deg_s, speed.deg_s2, speed.deg_s3)))
            for name, speed in arm.speeds
        },
        family=Family(arm.bus.family),
        baud_rate=arm.bus.baud,
        supply_v=arm.bus.supply_v,
        path=path,
        floor_m=arm.surroundings.floor_m,
        keep_out=tuple(
            KeepOutBox(box.name, box.low_m, box.high_m) for box in arm.surroundings.keep_out
        ),
        health=HealthLimits(**{name: each for name, each in arm.health if each is not None}),
        auto_unsafe="" if arm.calibration.auto else arm.calibration.reason or "no reason given",
        gripper=_make_gripper(path, arm.gripper, joints),
        base_frame=arm.base_frame or "",
        payload_kg=arm.payload_kg,
    )


def _read_tree(path: Path, arm: ArmFile) -> Urdf:
    """Read the URDF of an arm, and apply the limits and the base placement of the arm file.

    Collision shapes must be simple, so that the simulator can use them.
    """
    urdf = read_description(arm.urdf_path, path.parent)
    for link in urdf.links:
        if any(isinstance(shape, Mesh) for shape in link.collisions or link.visuals):
            found = f"link {link.name} has meshes as contact shapes"
            expected = f"boxes, cylinders and spheres; convert it: {import_command(arm.urdf_path)}"
            raise FileFormatError(arm.urdf_path, f"line {link.line}", found, expected)
    own = {
        entry.name: entry.limits_m or tuple(math.radians(each) for each in entry.limits_deg or ())
        for entry in arm.joints
    }
    joints = list[UrdfJoint]()
    for joint in urdf.joints:
        limits = own.get(joint.name)
        if limits and joint.kind.is_movable:
            turns = joint.kind is UrdfJointType.CONTINUOUS
            kind = UrdfJointType.REVOLUTE if turns else joint.kind
            joints.append(replace(joint, kind=kind, lower=limits[0], upper=limits[1]))
        else:
            joints.append(joint)
    urdf = replace(urdf, joints=tuple(joints))
    if arm.base is not None:
        urdf = turn_base(urdf, parse_frame(arm.base))
    links = [link.name for link in urdf.links]
    if arm.tip not in links:
        raise FileFormatError(path, "tip", f'is "{arm.tip}"', f"a link: {', '.join(links)}")
    return urdf


def _make_model_joint(path: Path, arm: ArmFile, index: int, urdf: Urdf) -> ModelJoint:
    entry = arm.joints[index]
    where = f"joints[{index}]"
    body = _find_moving_joint(path, where, entry, urdf)
    table = _find_control_table(path, f"{where}.servo.model", entry.servo.model)
    for i, shadow in enumerate(entry.shadows):
        _find_control_table(path, f"{where}.shadows[{i}].model", shadow.model)
    if table.family != arm.bus.family:
        found = f'is "{entry.servo.model}", a {table.family} servo'
        raise FileFormatError(path, f"{where}.servo.model", found, f"a {arm.bus.family} servo")
    servo = entry.servo
    place = (entry.name, servo.id, servo.sign, servo.zero_tick, table.ticks_per_turn)
    if servo.crank:
        zero_rad = math.radians(servo.crank.zero_deg)
        crank = Crank(servo.crank.radius_m, servo.crank.rod_m, zero_rad)
        joint_map = JointMap.cranked(*place, crank)
    elif servo.m_per_turn is None:
        joint_map = JointMap.revolute(*place, servo.gear)
    else:
        joint_map = JointMap.prismatic(*place, servo.m_per_turn)
    return ModelJoint(
        name=entry.name,
        role=entry.role,
        limits=Limits.of(entry.name, body.lower, body.upper, _ARM_FILE, joint_map.unit),
        joint_map=joint_map,
        travel_per_turn=joint_map.unit_per_horn_rad * math.tau,
        backlash=joint_map.unit_per_horn_rad * math.radians(entry.backlash_deg),
        servo=ModelServo(servo.id, servo.model, servo.eeprom),
        shadows=tuple(ModelServo(s.id, s.model, s.eeprom) for s in entry.shadows),
        zero_from=entry.zero_from,
    )


def _find_control_table(path: Path, where: str, model: str) -> type[ControlTable]:
    if model not in MODELS:
        raise FileFormatError(path, where, f'is "{model}"', f"one of: {', '.join(MODELS)}")
    return MODELS[model]


def _check_poses(path: Path, joints: Sequence[ModelJoint], arm: ArmFile) -> None:
    """Check that each pose is inside the limits."""
    limits = {joint.name: joint.limits for joint in joints}
    for pose, table in arm.poses.items():
        for name, position in _pose_positions(table).items():
            own, unit = limits[name], limits[name].unit
            if not own.contains(position):
                where = f"poses.{pose}.{'m' if unit == 'm' else 'deg'}.{name}"
                found = f"is {format_position(position, unit)}, outside its limits"
                low, high = (format_position(end.value, unit) for end in (own.lower, own.upper))
                raise FileFormatError(path, where, found, f"{low} to {high}")


def _find_moving_joint(path: Path, where: str, entry: ArmJoint, urdf: Urdf) -> UrdfJoint:
    moving = {joint.name: joint for joint in urdf.joints if joint.kind.is_movable}
    if entry.name not in moving:
        known = ", ".join(moving)
        raise FileFormatError(path, f"{where}.name", f'is "{entry.name}"', f"a joint of: {known}")
    joint = moving[entry.name]
    if joint.mimic is not None:
        found = f'"{entry.name}" follows "{joint.mimic.joint}" in the URDF (<mimic>)'
        raise FileFormatError(path, f"{where}.name", found, "a joint that a servo drives")
    if (joint.kind.value == "prismatic") != entry.is_prismatic:
        expected = "m_per_turn" if joint.kind.value == "prismatic" else "no m_per_turn"
        found = f'"{entry.name}" is {joint.kind.value} in the URDF'
        raise FileFormatError(path, f"{where}.servo", found, expected)
    return joint


def _pose_positions(pose: ArmPose) -> dict[str, float]:
    return {name: math.radians(value) for name, value in pose.deg.items()} | dict(pose.m)


def _make_gripper(path: Path, gripper: ArmGripper, joints: Sequence[ModelJoint]) -> Gripper | None:
    """Make the gripper; its jaws close towards the end of the range that is nearer to zero."""
    jaws = next((joint for joint in joints if joint.role == "gripper"), None)
    if jaws is None:
        return None
    ends = jaws.limits.lower.value, jaws.limits.upper.value
    if not all(map(math.isfinite, ends)):
        found = f'"{jaws.name}" is continuous in the description, so its jaws have no ends'
        expected = "its range: limits_deg = [lower, upper]"
        raise FileFormatError(path, f"joints[{joints.index(jaws)}]", found, expected)
    closed = min(ends, key=abs) if gripper.closes_to is None else ends[gripper.closes_to == "upper"]
    by_angle = tuple((math.radians(deg), width) for deg, width in gripper.width_m_by_deg)
    away = ends[1] if closed == ends[0] else ends[0]
    return Gripper(jaws.name, closed, away, by_angle or gripper.width_m_by_m)

"""Masses and inertia of an arm's links, and the compliance of its joints."""

from __future__ import annotations

from math import tau

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.inertia import LinkMass
from ikservo.kinematics.se3 import rotation_rpy
from ikservo.model.arm_model import Model, ModelJoint, ModelServo
from ikservo.model.servo_torque import find_servo_torque
from ikservo.model.urdf_types import UrdfLink

_FEETECH_GAIN = 32  # the P gain by default


def link_masses(model: Model, chain: Chain) -> list[LinkMass]:
    """Return the masses and inertia of a chain's links; links without a mass are omitted."""
    return [
        LinkMass(link.name, link.mass_kg, np.array(link.com_m), _inertia_tensor(link))
        for link in model.urdf.links
        if link.mass_kg > 0 and link.name in chain.frames
    ]


def _inertia_tensor(link: UrdfLink) -> Matrix:
    """Compute a link's inertia tensor (3, 3) about its centre of mass, in the link's axes."""
    ixx, ixy, ixz, iyy, iyz, izz = link.inertia_kg_m2
    R = rotation_rpy(*link.inertia_rpy_rad)
    return R @ np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]) @ R.T


def joint_compliances(model: Model, chain: Chain) -> Vector:
    """Compute the compliance of each joint (dof,) of a chain, rad per N m (m per N).

    A joint whose servo's stiffness is unknown has no compliance.

    Args:
        model: The servos.
        chain: The joints, base to tip; may end with the gripper's.
    """
    joints = {joint.name: joint for joint in model.joints}
    return np.array(
        [
            _joint_compliance(joints[name], model.supply_v) if name in joints else 0.0
            for name in chain.names
        ]
    )


def stall_error(joint: ModelJoint, supply_v: float | None) -> float:
    """Compute the distance from its goal at which friction keeps a joint without load, rad or m.

    Args:
        joint: The joint; servos that drive it together share its friction and its stiffness.
        supply_v: The supply of its servos, as in the arm file.
    """
    torque = find_servo_torque(joint.servo.model, supply_v)
    per_horn_rad = joint.travel_per_turn / tau
    gain = _gain_share(joint.servo)
    return per_horn_rad * torque.friction_rad / gain if torque and gain else 0.0


def _joint_compliance(joint: ModelJoint, supply_v: float | None) -> float:
    stiffness_nm_rad = sum(
        torque.stiffness_nm_rad * _gain_share(servo)
        for servo in (joint.servo, *joint.shadows)
        if (torque := find_servo_torque(servo.model, supply_v))
    )
    per_horn_rad = joint.travel_per_turn / tau
    return per_horn_rad**2 / stiffness_nm_rad if stiffness_nm_rad else 0.0


def _gain_share(servo: ModelServo) -> float:
    """Compute a servo's P gain as a fraction of the default."""
    return servo.eeprom.get("p_gain", _FEETECH_GAIN) / _FEETECH_GAIN

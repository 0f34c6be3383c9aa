"""Masses and inertia of an arm's links, and the compliance of its joints."""

from __future__ import annotations

from math import tau

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector
from ikservo.kinematics.inertia import LinkMass
from ikservo.kinematics.se3 import rotation_rpy
from ikservo.model.arm_model import Model, ModelJoint, ModelServo
from ikservo.model.servo_torque import find_servo_torque

_FEETECH_GAIN = 32  # default P gain


def link_masses(model: Model, chain: Chain) -> list[LinkMass]:
    """Return the masses and inertia of a chain's links; links without a mass are omitted."""
    masses: list[LinkMass] = []
    for link in model.urdf.links:
        if link.mass_kg > 0 and link.name in chain.frames:
            ixx, ixy, ixz, iyy, iyz, izz = link.inertia_kg_m2
            inertia = np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]])
            R = rotation_rpy(*link.inertia_rpy_rad)  # inertia frame to link frame
            masses.append(
                LinkMass(link.name, link.mass_kg, np.array(link.com_m), R @ inertia @ R.T)
            )
    return masses


def joint_compliances(model: Model, chain: Chain) -> Vector:
    """Compute the compliance of each joint (dof,) of a chain, rad per N m (m per N).

    The compliance of a joint is 0 if the stiffness of its servos is unknown. The chain goes from
    base to tip, and may end with the gripper's joint.
    """
    joints = {joint.name: joint for joint in model.joints}
    compliances = np.zeros(len(chain.names))
    for i, name in enumerate(chain.names):
        joint = joints.get(name)
        stiffness_nm_rad = 0.0
        for servo in (joint.servo, *joint.shadows) if joint else ():
            torque = find_servo_torque(servo.model, model.supply_v)
            if torque:
                stiffness_nm_rad += torque.stiffness_nm_rad * _gain_share(servo)
        if joint and stiffness_nm_rad:
            compliances[i] = (joint.travel_per_turn / tau) ** 2 / stiffness_nm_rad
    return compliances


def stall_error(joint: ModelJoint, supply_v: float | None) -> float:
    """Compute the distance from the goal at which friction holds an unloaded joint, rad or m.

    Servos that drive it together share its friction and its stiffness.
    """
    torque = find_servo_torque(joint.servo.model, supply_v)
    per_horn_rad = joint.travel_per_turn / tau
    gain = _gain_share(joint.servo)
    return per_horn_rad * torque.friction_rad / gain if torque and gain else 0.0


def _gain_share(servo: ModelServo) -> float:
    """Compute a servo's P gain as a fraction of the default."""
    return servo.eeprom.get("p_gain", _FEETECH_GAIN) / _FEETECH_GAIN

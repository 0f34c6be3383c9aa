"""Masses and inertia of an arm's links, and the compliance of its joints."""

from __future__ import annotations

from collections.abc import Mapping
from math import tau
from types import MappingProxyType

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.inertia import LinkMass
from ikservo.kinematics.se3 import rotation_rpy
from ikservo.model.model import Model, ModelJoint
from ikservo.model.urdf_types import UrdfLink

__all__ = ["STIFFNESS_NM_RAD", "joint_compliances", "link_masses"]

# Torque of each rad between goal and horn, at the gains that the servo has while an arm moves: as
# delivered, XL330 as `control.enabling` raises them. It is the duty of a rad times the torque of
# the whole duty: 0.163 P and 3.35 N m for the STS3215 (7.4 V), 10.1 N m for the STS3250;
# for Dynamixel P / 128 PWM steps of 885 for each tick, for the XL330 P / 256.
STIFFNESS_NM_RAD: Mapping[str, float] = MappingProxyType(
    {
        "STS3215": 17.5,
        "STS3250": 52.5,
        "SCS0009": 1.76,
        "SCS15": 11.5,
        "XL330-M288": 2.73,
        "XL330-M077": 1.13,
        "XL430-W250": 5.82,
        "XM430-W350": 19.9,
        "XM540-W270": 51.4,
        "AX-12A": 2.7,
        "MX-28": 6.4,
    }
)
_FEETECH_GAIN = 32  # the P gain as delivered


def link_masses(model: Model, chain: Chain) -> list[LinkMass]:
    """Return the masses and inertia of a chain's links; those without a mass are left out."""
    return [
        LinkMass(link.name, link.mass_kg, np.array(link.com_m), _inertia_tensor(link))
        for link in model.urdf.links
        if link.mass_kg > 0 and link.name in chain.frames
    ]


def _inertia_tensor(link: UrdfLink) -> Matrix:
    """Return a link's inertia tensor (3, 3) about its centre of mass, in the link's axes."""
    ixx, ixy, ixz, iyy, iyz, izz = link.inertia_kg_m2
    R = rotation_rpy(*link.inertia_rpy_rad)
    return R @ np.array([[ixx, ixy, ixz], [ixy, iyy, iyz], [ixz, iyz, izz]]) @ R.T


def joint_compliances(model: Model, chain: Chain) -> Vector:
    """Return the compliance of each joint (dof,) of a chain, rad for each N m (m for each N).

    A joint whose servo's stiffness is unknown has no compliance.

    Args:
        model: The servos.
        chain: The joints, base to tip; may end with the gripper's.
    """
    joints = {joint.name: joint for joint in model.joints}
    return np.array(
        [_joint_compliance(joints[name]) if name in joints else 0.0 for name in chain.names]
    )


def _joint_compliance(joint: ModelJoint) -> float:
    stiffness_nm_rad = sum(
        STIFFNESS_NM_RAD.get(servo.model, 0.0) * servo.eeprom.get("p_gain", _FEETECH_GAIN)
        for servo in (joint.servo, *joint.shadows)
    ) / _FEETECH_GAIN  # fmt: skip
    per_horn_rad = joint.travel_per_turn / tau
    return per_horn_rad**2 / stiffness_nm_rad if stiffness_nm_rad else 0.0

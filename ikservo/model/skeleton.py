"""The chain of a URDF: its joints as kinematics knows them."""

from __future__ import annotations

import numpy as np

from ikservo.kinematics import Chain, Joint, JointKind, Mimic
from ikservo.kinematics.se3 import pose, rotation_rpy
from ikservo.model.urdf import JointKind as UrdfJointKind
from ikservo.model.urdf import Urdf, UrdfJoint

__all__ = ["chain_of"]

_KINDS = {
    UrdfJointKind.FIXED: JointKind.FIXED,
    UrdfJointKind.REVOLUTE: JointKind.REVOLUTE,
    UrdfJointKind.CONTINUOUS: JointKind.REVOLUTE,
    UrdfJointKind.PRISMATIC: JointKind.PRISMATIC,
}


def chain_of(urdf: Urdf, tip: str) -> Chain:
    """Return the chain from the URDF's root to a link.

    Raises:
        UnknownNameError: The URDF has no such link.
        InputError: No joint moves it.
    """
    return Chain.from_joints([_joint(joint) for joint in urdf.joints], urdf.root, tip)


def _joint(joint: UrdfJoint) -> Joint:
    follows = joint.mimic
    return Joint(
        name=joint.name,
        kind=_KINDS[joint.kind],
        parent=joint.parent,
        child=joint.child,
        origin=pose(joint.xyz_m, rotation_rpy(*joint.rpy_rad)),
        axis=np.array(joint.axis),
        lower=joint.lower,
        upper=joint.upper,
        mimic=follows and Mimic(follows.joint, follows.multiplier, follows.offset),
    )

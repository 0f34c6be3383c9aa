"""Forward kinematics, Jacobians, dynamics, and geometry of links: pure functions on arrays."""

from ikservo.kinematics.arrays import finite_array, finite_vector, finite_vectors
from ikservo.kinematics.chain import Chain, joint_torques
from ikservo.kinematics.conditioning import (
    Conditioning,
    Singularity,
    conditioning,
    distance_to_limits,
    manipulability,
    nearest_singularity,
)
from ikservo.kinematics.dynamics import Dynamics
from ikservo.kinematics.inertia import LinkMass
from ikservo.kinematics.joint_index import JointIndex
from ikservo.kinematics.joints import ChainJoint, Joint, JointType, Mimic
from ikservo.kinematics.packed import pack_chain

__all__ = [
    "Chain",
    "ChainJoint",
    "Conditioning",
    "Dynamics",
    "Joint",
    "JointIndex",
    "JointType",
    "LinkMass",
    "Mimic",
    "Singularity",
    "conditioning",
    "distance_to_limits",
    "finite_array",
    "finite_vector",
    "finite_vectors",
    "joint_torques",
    "manipulability",
    "nearest_singularity",
    "pack_chain",
]

"""Where the links are for given joints, and how they move: pure functions on arrays."""

from ikservo.kinematics.chain import Chain
from ikservo.kinematics.conditioning import (
    Conditioning,
    Singularity,
    conditioning,
    nearest_singularity,
)
from ikservo.kinematics.joints import Joint, JointKind, Mimic
from ikservo.kinematics.numbers import finite_array, finite_vector, finite_vectors
from ikservo.kinematics.packing import pack
from ikservo.kinematics.quality import manipulability, room_to_limits
from ikservo.kinematics.steps import Step
from ikservo.kinematics.virtual_work import joint_torques

__all__ = [
    "Chain",
    "Conditioning",
    "Joint",
    "JointKind",
    "Mimic",
    "Singularity",
    "Step",
    "conditioning",
    "finite_array",
    "finite_vector",
    "finite_vectors",
    "joint_torques",
    "manipulability",
    "nearest_singularity",
    "pack",
    "room_to_limits",
]

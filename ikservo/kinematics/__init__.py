"""Where the links are for given joints, and how they move: pure functions on arrays."""

from ikservo.kinematics.chain import Chain
from ikservo.kinematics.joints import Joint, JointKind, Mimic
from ikservo.kinematics.numbers import finite_array, finite_vector, finite_vectors
from ikservo.kinematics.packing import pack
from ikservo.kinematics.quality import manipulability, room_to_limits
from ikservo.kinematics.steps import Step

__all__ = [
    "Chain",
    "Joint",
    "JointKind",
    "Mimic",
    "Step",
    "finite_array",
    "finite_vector",
    "finite_vectors",
    "manipulability",
    "pack",
    "room_to_limits",
]

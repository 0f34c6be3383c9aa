"""Where the links are for given joints, and how they move: pure functions on arrays."""

from ikservo.kinematics.chain import Chain, Joint, JointKind, Mimic, finite_array, finite_vector

__all__ = ["Chain", "Joint", "JointKind", "Mimic", "finite_array", "finite_vector"]

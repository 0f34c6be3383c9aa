"""Poses of an arm's links in their parents, as ``/tf`` lists them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.joints import ChainJoint


class LinkTransforms:
    """Computation of the pose of every link except the base in its parent.

    Args:
        chain: The arm.
        names: Names of all joints with a servo, in the order used in the vectors (n,).

    Attributes:
        links: Parent and child of each pose (k).
    """

    def __init__(self, chain: Chain, names: Sequence[str]) -> None:
        self._steps = [
            _column_of_all(chain.joints_to(link)[-1], chain, names)
            for link in chain.frames
            if link != chain.base
        ]
        self.links = tuple((step.joint.parent, step.joint.child) for step in self._steps)

    def poses(self, positions: Vector) -> Matrix:
        """Return T_parent_link (k, 4, 4) at positions (n,), rad or m, including the jaws."""
        return np.array([step.joint.origin @ step.motion(positions) for step in self._steps])


def _column_of_all(step: ChainJoint, chain: Chain, names: Sequence[str]) -> ChainJoint:
    """Return a joint that takes its value from the vector of all joints.

    The chain from base to tip does not contain every joint: a jaw, for example, is a branch of it.
    """
    joint = step.joint
    if step.scale:
        return ChainJoint(joint, names.index(chain.names[step.column]), step.scale, step.shift)
    if joint.name in names:
        return ChainJoint(joint, names.index(joint.name), 1.0, 0.0)
    mimic = joint.mimic
    if mimic is not None and mimic.joint in names:
        return ChainJoint(joint, names.index(mimic.joint), mimic.multiplier, mimic.offset)
    return step


def quaternions(R: Matrix) -> Matrix:
    """Return x, y, z, w (k, 4) of rotations (k, 3, 3), w >= 0.

    The quaternion is the eigenvector for the largest eigenvalue of a symmetric matrix built from
    the elements of R, and is exact for every angle.

    Source: I. Y. Bar-Itzhack, New method for extracting the quaternion from a rotation matrix,
    J. Guidance, Control, and Dynamics 23 (2000).
    """
    antisymmetric = R - R.swapaxes(-1, -2)
    K = np.zeros((len(R), 4, 4))
    K[:, :3, :3] = R + R.swapaxes(-1, -2) - np.trace(R, axis1=1, axis2=2)[:, None, None] * np.eye(3)
    K[:, 3, 0], K[:, 3, 1] = antisymmetric[:, 2, 1], antisymmetric[:, 0, 2]
    K[:, 3, 2], K[:, 3, 3] = antisymmetric[:, 1, 0], np.trace(R, axis1=1, axis2=2)
    _, vectors = np.linalg.eigh(K)  # reads the lower triangle
    q = vectors[..., -1]
    return np.where(q[:, 3:] < 0.0, -q, q)

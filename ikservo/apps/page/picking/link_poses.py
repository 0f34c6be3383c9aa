"""Poses of all links of an arm, including links that the chain to its tip does not move."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ikservo.kinematics import Chain, Joint
from ikservo.kinematics.arrays import Matrix, Vector


def link_poses(chain: Chain, q: Vector, other_joints: Mapping[str, float]) -> dict[str, Matrix]:
    """Compute T_world_link (4, 4) of each link at q (dof,) and other joints, rad or m (or 0)."""
    poses = {chain.base: np.eye(4)}
    for link in chain.frames:
        if link == chain.base:
            continue
        step = chain.joints_to(link)[-1]
        value = None if step.scale else other_joint_position(step.joint, other_joints)
        motion = step.motion(q) if value is None else step.motion_at(value)
        poses[link] = poses[step.joint.parent] @ step.joint.origin @ motion
    return poses


def other_joint_position(joint: Joint, other_joints: Mapping[str, float]) -> float | None:
    """Compute the position of a joint that q does not move, rad or m; None if it is unknown."""
    if joint.mimic is None:
        return other_joints.get(joint.name)
    leader = other_joints.get(joint.mimic.joint)
    return None if leader is None else joint.mimic.multiplier * leader + joint.mimic.offset

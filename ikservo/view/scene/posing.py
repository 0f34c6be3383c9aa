"""Where all links are, those of the gripper included, which is beside the way to the tip."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from ikservo.kinematics import Chain, Joint
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["link_poses"]


def link_poses(chain: Chain, q: Vector, beside: Mapping[str, float]) -> dict[str, Matrix]:
    """Return T_world_link (4, 4) of every link.

    Args:
        chain: The arm.
        q: Joints (dof,).
        beside: Positions of joints that q does not move, rad or m; the others stand still.
    """
    poses = {chain.base: np.eye(4)}
    for link in chain.frames:
        if link == chain.base:
            continue
        step = chain.way(link)[-1]
        value = None if step.scale else _value(step.joint, beside)
        motion = step.motion(q) if value is None else step.at(value)
        poses[link] = poses[step.joint.parent] @ step.joint.origin @ motion
    return poses


def _value(joint: Joint, beside: Mapping[str, float]) -> float | None:
    if joint.mimic is None:
        return beside.get(joint.name)
    leader = beside.get(joint.mimic.joint)
    return None if leader is None else joint.mimic.multiplier * leader + joint.mimic.offset

"""Dials that show the range of each joint: pivot, and direction of the needle."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from ikservo.kinematics import Chain, ChainJoint, JointType
from ikservo.kinematics.arrays import Matrix, Vector

_MIN_ARM_M = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class JointDial:
    """A joint's place in the chain, and the direction of its needle.

    Attributes:
        column: The index of the joint in q.
        step: The joint in the chain.
        needle: A unit vector (3,) perpendicular to the axis, in the child link's coordinates.
    """

    name: str
    column: int
    step: ChainJoint
    needle: Vector

    @property
    def is_prismatic(self) -> bool:
        """Whether the joint is prismatic."""
        return self.step.joint.kind is JointType.PRISMATIC

    def pivot_and_axis(self, poses: Mapping[str, Matrix]) -> tuple[Vector, Vector]:
        """Return pivot (3,) [m] (zero position if prismatic) and axis (3,), world coordinates."""
        joint = self.step.joint
        T_world_joint = poses[joint.parent] @ joint.origin
        return T_world_joint[:3, 3], T_world_joint[:3, :3] @ joint.axis

    def hub(self, poses: Mapping[str, Matrix], q: Vector) -> Vector:
        """Compute the joint's hub (3,): its pivot, shifted by the position if prismatic."""
        pivot, axis = self.pivot_and_axis(poses)
        return pivot + float(q[self.column]) * axis if self.is_prismatic else pivot


def joint_dials(chain: Chain, q: Vector) -> tuple[JointDial, ...]:
    """Compute a dial for each joint that q (dof,) moves; needles point to the next joint."""
    moving = [step for step in chain.joints_to() if step.joint.mimic is None and step.scale]
    poses = chain.link_poses(q)
    ends = [(poses[step.joint.parent] @ step.joint.origin)[:3, 3] for step in moving[1:]]
    ends.append(poses[chain.tip][:3, 3])
    return tuple(
        JointDial(
            step.joint.name,
            step.column,
            step,
            _needle_direction(step, poses[step.joint.child], end),
        )
        for step, end in zip(moving, ends, strict=True)
    )


def _needle_direction(step: ChainJoint, T_world_child: Matrix, towards_m: Vector) -> Vector:
    """Compute the direction (3,) to a point, perpendicular to the axis, child's coordinates."""
    axis = step.joint.axis
    offset = T_world_child[:3, :3].T @ (towards_m - T_world_child[:3, 3])
    across = offset - axis * float(axis @ offset)
    if math.sqrt(float(across @ across)) < _MIN_ARM_M:  # a roll joint: choose any direction
        helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
        across = helper - axis * float(axis @ helper)
    return across / math.sqrt(float(across @ across))

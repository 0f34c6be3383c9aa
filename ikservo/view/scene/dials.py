"""Where each joint of an arm is, which way its needle points, and how near it is to a limit."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np

from ikservo.kinematics import Chain, JointKind, Step
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.model.joint_limits import at_limit, near_limit

__all__ = ["Dial", "dials_of", "nearness"]

Nearness = Literal["limit", "amber", "red"]

_LEAST_ARM_M = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class Dial:
    """Where a joint is in the chain, and which way its needle points.

    Attributes:
        column: The joint's entry of q.
        step: The joint on its way to the tip.
        needle: A unit vector (3,) across the axis, in the child link's coordinates.
        side: The third one (3,), where the needle points after a quarter of a turn.
    """

    name: str
    column: int
    step: Step
    needle: Vector
    side: Vector

    @property
    def slides(self) -> bool:
        """Return whether the joint is a slide."""
        return self.step.joint.kind is JointKind.PRISMATIC

    def place(self, poses: Mapping[str, Matrix]) -> tuple[Vector, Vector]:
        """Return the pivot (3,) [m], of a slide its zero, and the axis (3,), world coordinates."""
        joint = self.step.joint
        T_world_joint = poses[joint.parent] @ joint.origin
        return T_world_joint[:3, 3], T_world_joint[:3, :3] @ joint.axis

    def hub(self, poses: Mapping[str, Matrix], q: Vector) -> Vector:
        """Return where the joint is (3,): its pivot, or how far it has slid."""
        pivot, axis = self.place(poses)
        return pivot + float(q[self.column]) * axis if self.slides else pivot


def dials_of(chain: Chain, q: Vector) -> tuple[Dial, ...]:
    """Return a dial for each joint that q (dof,) moves; needles point to the next joint."""
    moving = [step for step in chain.way() if step.joint.mimic is None and step.scale]
    poses = chain.link_poses(q)
    ends = [(poses[step.joint.parent] @ step.joint.origin)[:3, 3] for step in moving[1:]]
    ends.append(poses[chain.tip][:3, 3])
    return tuple(
        _dial(step, _needle(step, poses[step.joint.child], end))
        for step, end in zip(moving, ends, strict=True)
    )


def _dial(step: Step, needle: Vector) -> Dial:
    side = np.cross(step.joint.axis, needle)
    return Dial(step.joint.name, step.column, step, needle, side)


def nearness(chain: Chain, q: Vector, column: int) -> Nearness:
    """Return ``amber`` near a limit, ``red`` at it, else ``limit``."""
    joint = (float(q[column]), float(chain.lower_rad[column]), float(chain.upper_rad[column]))
    unit = "m" if chain.kinds[column] is JointKind.PRISMATIC else "rad"
    return "red" if at_limit(*joint, unit) else "amber" if near_limit(*joint, unit) else "limit"


def _needle(step: Step, T_world_child: Matrix, towards_m: Vector) -> Vector:
    """Return the direction (3,) across the axis to a point, in the child's coordinates."""
    axis = step.joint.axis
    way = T_world_child[:3, :3].T @ (towards_m - T_world_child[:3, 3])
    across = way - axis * float(axis @ way)
    if math.sqrt(float(across @ across)) < _LEAST_ARM_M:  # a roll: any direction will do
        helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
        across = helper - axis * float(axis @ helper)
    return across / math.sqrt(float(across @ across))

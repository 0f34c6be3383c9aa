"""Point an axis of the tip at a point; the position of the tip is free."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.ik.problem import check_position, normalise
from ikservo.ik.result import ActiveLimit
from ikservo.ik.solve import solve
from ikservo.kinematics import Chain, finite_vector
from ikservo.kinematics.arrays import FrozenArrays, Vector
from ikservo.kinematics.joints import JointType

_NEAREST_M = 0.001  # points nearer to the tip have no usable direction from it
_REACHED_RAD = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Sight(FrozenArrays):
    """Joints that point an axis of the tip at a point, or as near to the point as was found.

    Attributes:
        q: The joints (dof,), rad or m.
        error_rad: The angle between the axis and the direction to the point.
        binding: The limits that keep the axis from pointing at the point.
        reached: Whether the axis points at the point.
    """

    q: Vector
    error_rad: float
    binding: tuple[ActiveLimit, ...]

    @property
    def reached(self) -> bool:
        """Whether the axis points at the point to within 0.1 mrad."""
        return self.error_rad <= _REACHED_RAD


def solve_sight(chain: Chain, point_m: ArrayLike, q0: ArrayLike, axis: ArrayLike) -> Sight:
    """Find joint positions inside the limits, near ``q0``, that point the tip's axis at a point.

    The line of sight acts as one more joint, which slides along the axis; the arm reaches the point
    with the end of this joint.

    Args:
        chain: The arm.
        point_m: The point (3,), metres, base frame.
        q0: The joints (dof,) to start from, rad or m.
        axis: The axis (3,) in the tip's coordinates.

    Raises:
        BadValueError: A shape is wrong, a number is not finite or too large, or the axis is zero.
    """
    point = check_position(point_m, "The point to look at")
    ahead = normalise(axis, "The axis to look along")
    start = finite_vector(q0, chain.dof, "q0")
    # The largest distance of the tip from the base, including the travel of prismatic joints.
    bones_m = sum(float(np.linalg.norm(step.joint.origin[:3, 3])) for step in chain.joints_to())
    slides = [kind is JointType.PRISMATIC for kind in chain.kinds]
    ends = np.maximum(np.abs(chain.lower_rad), np.abs(chain.upper_rad))
    reach_m = bones_m + float(ends[slides].sum())
    farthest_m = float(np.linalg.norm(point)) + reach_m
    distance_m = float(np.linalg.norm(point - chain.forward(start)[:3, 3]))
    seeing = chain.with_slide(ahead, _NEAREST_M, max(farthest_m, 2.0 * _NEAREST_M))
    found = solve(seeing, point, np.append(start, min(max(distance_m, _NEAREST_M), farthest_m)))
    q = found.q[:-1]
    binding = tuple(limit for limit in found.binding if limit.joint in chain.names)
    T = chain.forward(q)
    pointing, towards = T[:3, :3] @ ahead, point - T[:3, 3]
    sine = float(np.linalg.norm(np.cross(pointing, towards)))
    return Sight(q, math.atan2(sine, float(pointing @ towards)), binding)

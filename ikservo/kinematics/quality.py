"""How well an arm stands: how freely its tool can move, how far its joints are from limits."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ikservo.kinematics.chain import Chain
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["manipulability", "room_to_limits"]


def manipulability(J: Matrix) -> Vector:
    """Return Yoshikawa's measure ``sqrt(det(J Jᵀ))`` (), or (n,) for many Jacobians.

    Zero where the tool cannot move in some direction of the rows given. Take the three linear
    rows for positions ``J[..., :3, :]`` [m³], all six for poses.

    Source: T. Yoshikawa, Manipulability of Robotic Mechanisms, IJRR 4(2), 1985. With fewer
    joints than rows the product of the singular values that there are.
    """
    return np.prod(np.linalg.svd(J, compute_uv=False), axis=-1)


def room_to_limits(chain: Chain, q: ArrayLike) -> Vector:
    """Return (dof,) or (n, dof): how far each joint is inside its nearer limit, rad or m.

    Negative outside, infinite for a continuous joint.
    """
    joints = np.asarray(q, dtype=np.float64)
    return np.minimum(joints - chain.lower_rad, chain.upper_rad - joints)

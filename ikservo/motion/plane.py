"""The upright plane in which an arm without a free wrist works, turned by its first joint."""

from __future__ import annotations

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector, exp_so3

__all__ = ["ArmPlane"]

_FREE_WRIST_DOF = 6
_PARALLEL = 0.99


class ArmPlane:
    """How far the plane of an arm is turned about the vertical.

    An arm of four or five joints turns its tool's heading with its first joint, whether one wants
    it or not; in the plane, what is left to it is pitch and roll. Arms with six joints or more,
    and such that lie flat, have no plane: they keep an orientation in the world.

    Args:
        chain: The arm.
        in_world: Whether orientations count in the world all the same.
    """

    def __init__(self, chain: Chain, *, in_world: bool = False) -> None:
        axes = chain.jacobian(chain.middle())[3:, :2].T
        upright = abs(float(axes[0, 2])) > _PARALLEL
        swings = chain.dof > 1 and abs(float(axes[0] @ axes[-1])) < 1.0 - _PARALLEL
        self.turns = not in_world and chain.dof < _FREE_WRIST_DOF and upright and swings
        self._axis: Vector = np.sign(axes[0, 2]) * np.array([0.0, 0.0, 1.0])

    def angle_rad(self, q: Vector) -> float:
        """Return how far the plane is turned at joints (dof,); 0 for arms without one."""
        return float(self._axis[2] * q[0]) if self.turns else 0.0

    def rotation(self, q: Vector) -> Matrix:
        """Return the rotation R_world_plane (3, 3) at joints (dof,)."""
        return exp_so3(np.array([0.0, 0.0, self.angle_rad(q)]))

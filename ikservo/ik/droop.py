"""Targets for an arm that sags under its weight, raised by the sag of the tip at the target.

Kernels solve rigid arms. A rigid arm must go to the target's pose minus the displacement by the
sag. Each new solution changes this displacement by about a tenth, so the displacement
converges after a few solutions.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ikservo.ik.problem import Target
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector

_SAME_M = 1e-8  # a smaller change of the sag does not count
_SAME_RAD = 1e-7  # the same for the rotation that the sag causes
_STEADY_M = 1e-4  # remaining error that counts as reached
_STEADY_RAD = 1e-3  # the same for the rotation


class Droop:
    """Sag of a point of an arm at the last joints given to ``follow``.

    Args:
        chain: An arm with ``link_joints``.
        frame: The link; the tip if None.
        offset_m: The point (3,) on that link, metres; the link's origin if None.

    Attributes:
        is_steady: Whether the sag hardly changed with the last joints.
        max_steps: Number of times that a target is raised before it counts as not reached.
    """

    max_steps = 12

    def __init__(self, chain: Chain, frame: str | None, offset_m: ArrayLike | None) -> None:
        self._chain, self._point = chain, (frame, offset_m)
        self._moved, self._turned = np.zeros(3), np.eye(3)
        self.is_steady = False

    def follow(self, q: Vector) -> bool:
        """Compute the sag at joints (dof,); return whether it has changed."""
        rigid = self._chain.rigid.forward(q, *self._point)
        links = self._chain.forward(q, *self._point)
        moved, turned = links[:3, 3] - rigid[:3, 3], links[:3, :3] @ rigid[:3, :3].T
        apart = np.abs(moved - self._moved).max(), np.abs(turned - self._turned).max()
        self.is_steady = bool(apart[0] <= _STEADY_M and apart[1] <= _STEADY_RAD)
        self._moved, self._turned = moved, turned
        return bool(apart[0] > _SAME_M or apart[1] > _SAME_RAD)

    def raised_pose(self, T: Matrix) -> Matrix:
        """Compute the pose (4, 4) of a rigid arm whose joints bring this arm to ``T``."""
        raised = T.copy()
        raised[:3, 3] -= self._moved
        raised[:3, :3] = self._turned.T @ T[:3, :3]
        return raised

    def raised(self, target: Target) -> Target:
        """Return the target that a rigid arm must be given to bring this arm to ``target``."""
        position = target.position - self._moved
        if target.rotation is not None:
            return replace(
                target, position_m=position, orientation=self._turned.T @ target.rotation
            )
        if target.target_axis is not None:
            return replace(
                target, position_m=position, direction=self._turned.T @ target.target_axis
            )
        return replace(target, position_m=position)

    def lowered(self, point_m: Vector) -> Vector:
        """Compute the position of a point that would be at ``point_m`` (3,) on a rigid arm."""
        return point_m + self._moved

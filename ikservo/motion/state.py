"""Where joints are and how they move at one instant."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.kinematics.se3 import Vector

__all__ = ["State"]


@dataclass(frozen=True, slots=True, eq=False)
class State:
    """Position, velocity and acceleration of n joints; rad, or m for prismatic ones."""

    position: Vector
    velocity: Vector
    acceleration: Vector

    @classmethod
    def rest(cls, position: ArrayLike) -> State:
        """Return the state of joints (n,) that stand still."""
        at = np.asarray(position, dtype=np.float64)
        return cls(at, np.zeros_like(at), np.zeros_like(at))

"""Rotations as MuJoCo and as a URDF write them."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ikservo.kinematics.se3 import Matrix

__all__ = ["place_of", "rpy_of", "turned"]


def turned(quaternion: ArrayLike) -> Matrix:
    """Return the rotation (3, 3) of a unit quaternion w, x, y, z."""
    w, x, y, z = np.asarray(quaternion, dtype=np.float64)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )


def rpy_of(T: Matrix) -> tuple[float, float, float]:
    """Return roll, pitch, yaw of a pose (4, 4): R = Rz(yaw) @ Ry(pitch) @ Rx(roll)."""
    level = math.hypot(T[0, 0], T[1, 0])
    pitch = math.atan2(-T[2, 0], level)
    if level < 1e-9:  # roll and yaw turn about one axis
        return math.atan2(-T[1, 2], T[1, 1]), pitch, 0.0
    return math.atan2(T[2, 1], T[2, 2]), pitch, math.atan2(T[1, 0], T[0, 0])


def place_of(T: Matrix) -> tuple[float, float, float]:
    """Return the origin of a pose (4, 4)."""
    x, y, z = (float(value) for value in T[:3, 3])
    return x, y, z

"""Rotations and poses: SO(3) and SE(3) on plain arrays.

A pose ``T_world_tool`` is (4, 4) and maps tool coordinates to world coordinates.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ikservo.kinematics.arrays import Matrix, Vector

# Below this angle the closed forms divide two vanishing numbers; the Taylor series are exact to
# 1e-16.
_SMALL_RAD = 1e-4
# For angles within this distance of pi the antisymmetric part of R vanishes, and the axis must come
# from the symmetric part.
_NEAR_PI_RAD = 1e-3


def skew(v: ArrayLike) -> Matrix:
    """Compute the (3, 3) matrix with ``skew(v) @ w == cross(v, w)``."""
    x, y, z = np.asarray(v, dtype=np.float64)
    return np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])


def exp_so3(w_rad: ArrayLike) -> Matrix:
    """Compute the rotation (3, 3) about a vector ``w_rad`` (3,) by its length (Rodrigues)."""
    w = np.asarray(w_rad, dtype=np.float64)
    theta = math.sqrt(float(w @ w))
    # a = sin(θ)/θ and b = (1 - cos θ)/θ²
    a, b = 1.0 - theta * theta / 6.0, 0.5  # multiplied by θ², the next term is below rounding
    if theta >= _SMALL_RAD:
        half = math.sin(0.5 * theta) / (0.5 * theta)
        a, b = math.sin(theta) / theta, 0.5 * half * half
    W = skew(w)
    return np.eye(3) + a * W + b * (W @ W)


def log_so3(R: ArrayLike) -> Vector:
    """Compute the rotation vector (3,) [rad] with ``exp_so3(log_so3(R)) == R``, length <= pi."""
    R = np.asarray(R, dtype=np.float64)
    axis_sin = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sin = math.sqrt(float(axis_sin @ axis_sin))
    cos = 0.5 * (float(np.trace(R)) - 1.0)
    theta = math.atan2(sin, cos)
    if math.pi - theta < _NEAR_PI_RAD:
        # The axis of a rotation by pi is the largest column of (R + Rᵀ)/2 - cos θ I.
        S = 0.5 * (R + R.T) - cos * np.eye(3)
        column = S[:, int(np.argmax(np.diag(S)))]
        axis = column / math.sqrt(float(column @ column))
        # At exactly pi both signs are the same rotation; below it the sine part decides.
        return theta * (-axis if float(axis @ axis_sin) < 0.0 else axis)
    # sin = theta - theta³/6: the quotient tends to one without a division by zero.
    return axis_sin * (1.0 + theta * theta / 6.0 if theta < _SMALL_RAD else theta / sin)


def make_pose(position_m: ArrayLike, rotation: ArrayLike | None = None) -> Matrix:
    """Make the pose (4, 4) from a position (3,) [m] and a rotation (3, 3), default identity."""
    T = np.eye(4)
    T[:3, 3] = position_m
    if rotation is not None:
        T[:3, :3] = rotation
    return T


def rotation_rpy(roll_rad: float, pitch_rad: float, yaw_rad: float) -> Matrix:
    """Compute the rotation (3, 3) of URDF's ``rpy``: Rz(yaw) Ry(pitch) Rx(roll), fixed axes."""
    cr, sr = math.cos(roll_rad), math.sin(roll_rad)
    cp, sp = math.cos(pitch_rad), math.sin(pitch_rad)
    cy, sy = math.cos(yaw_rad), math.sin(yaw_rad)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def quaternion_to_matrix(quaternion: ArrayLike) -> Matrix:
    """Compute the rotation (3, 3) of a unit quaternion w, x, y, z."""
    w, x, y, z = np.asarray(quaternion, dtype=np.float64)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )

"""The planes a person looks at an arm in: from the side, from the front, from above."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ikservo.kinematics import Chain, JointKind
from ikservo.kinematics.se3 import Matrix, Vector, pose

__all__ = ["front_plane", "side_plane", "top_plane"]

# A tool that hangs a little beside its arm's middle shall not turn the plane of the arm.
_YAW_STEP_RAD = math.radians(15)


def side_plane(chain: Chain, home: ArrayLike, yaw_rad: float | None = None) -> Matrix:
    """Return the arm's own vertical plane, through its first axis.

    Args:
        chain: The arm.
        home: Joints (dof,) that point the arm where it usually works.
        yaw_rad: Where the plane looks, about z; where ``home`` points if None.

    Returns:
        T_world_plane (4, 4): u outward, v up, w across; u counts from the base's origin.
    """
    pivot, forward_rad = _first_axis(chain, home)
    return _upright(pivot, forward_rad if yaw_rad is None else yaw_rad)


def front_plane(chain: Chain, home: ArrayLike, yaw_rad: float | None = None) -> Matrix:
    """Return the vertical plane through the first axis across the arm: u left, v up."""
    pivot, forward_rad = _first_axis(chain, home)
    return _upright(pivot, (forward_rad if yaw_rad is None else yaw_rad) + math.pi / 2)


def top_plane(chain: Chain, home: ArrayLike, height_m: float | None = None) -> Matrix:
    """Return the horizontal plane at a height, that of the tip at ``home`` if None."""
    tip = chain.forward(home)[:3, 3]
    return pose((0.0, 0.0, float(tip[2]) if height_m is None else height_m))


def _upright(through: Vector, yaw_rad: float) -> Matrix:
    """Return a vertical plane through a point; its origin is the one nearest the base's."""
    u = np.array([math.cos(yaw_rad), math.sin(yaw_rad), 0.0])
    v = np.array([0.0, 0.0, 1.0])
    w = np.cross(u, v)
    return pose(float(through @ w) * w, np.column_stack([u, v, w]))


def _first_axis(chain: Chain, home: ArrayLike) -> tuple[Vector, float]:
    """Return a point (3,) on the first axis and the direction in which the tip is from there."""
    T, J = chain.linearise(home)
    tip: Vector = T[:3, 3]
    pivot = np.zeros(3)
    if chain.kinds[0] is JointKind.REVOLUTE:
        # J = axis x (tip - pivot), so axis x J leads from the tip back to the axis.
        pivot = tip + np.cross(J[3:, 0], J[:3, 0])
    yaw_rad = math.atan2(float(tip[1] - pivot[1]), float(tip[0] - pivot[0]))
    return pivot, _YAW_STEP_RAD * round(yaw_rad / _YAW_STEP_RAD)

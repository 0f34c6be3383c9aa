"""Seeds as the kernels read them: joints, where the tool is there, how far the first may swing."""

from __future__ import annotations

import math

import numpy as np

from ikservo.ik.kernel.layout import (
    SEED_COSINE,
    SEED_FAR2,
    SEED_POSITION,
    SEED_ROTATION,
    SEED_SINE,
    SEED_SIZE,
    SEED_SWING,
)
from ikservo.kinematics import Chain
from ikservo.kinematics.packing import COLUMN, POSITION, ROTATION, SWINGS
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["marked"]


def marked(
    chain: Chain,
    arm: Matrix,
    q: Matrix,
    frame: str | None,
    offset_m: Vector | None,
    turn: Matrix,
    *,
    swinging: bool,
) -> Matrix:
    """Return joints (m, dof) as columns (dof + SEED_SIZE, m).

    Args:
        chain: The arm.
        arm: The arm, packed.
        q: Starting points inside the limits (m, dof).
        frame: The link that shall go there.
        offset_m: The point of it.
        turn: R_frame_tool (3, 3).
        swinging: Whether the search may swing the first joint to where the tool comes nearest.
    """
    n, first = chain.dof, int(arm[1, COLUMN])
    half_rad, stood = 0.0, q.copy()
    if swinging and arm[0, SWINGS] == 1.0:
        middle, half_rad = _swing(float(chain.lower_rad[first]), float(chain.upper_rad[first]))
        stood[:, first] = middle
    T = chain.forward(stood, frame, offset_m)
    base = arm[1, ROTATION : ROTATION + 9].reshape(3, 3)
    p = (T[:, :3, 3] - arm[1, POSITION : POSITION + 3]) @ base
    columns = np.zeros((n + SEED_SIZE, len(q)))
    columns[:n], marks = q.T, columns[n:]
    marks[SEED_ROTATION : SEED_ROTATION + 9] = (base.T @ T[:, :3, :3] @ turn).reshape(-1, 9).T
    marks[SEED_POSITION : SEED_POSITION + 3], marks[SEED_FAR2] = p.T, np.sum(p * p, axis=1)
    marks[SEED_SWING] = stood[:, first]
    marks[SEED_COSINE], marks[SEED_SINE] = math.cos(half_rad), math.sin(half_rad)
    return columns


def _swing(lower_rad: float, upper_rad: float) -> tuple[float, float]:
    """Return the middle of a joint's swing and how far it goes to either side, at most a turn."""
    if upper_rad - lower_rad >= 2.0 * math.pi:
        return min(max(0.0, lower_rad + math.pi), upper_rad - math.pi), math.pi
    return 0.5 * (lower_rad + upper_rad), 0.5 * (upper_rad - lower_rad)

"""The last nanometres of arms that have their structure only nearly: Newton steps on the arm."""

from __future__ import annotations

import numpy as np

from ikservo.ik.target import Target
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["sharpened"]

_STEPS = 6
_MET = 1e-10
# Singular values this much below the largest belong to turns that move nothing.
_TRUNCATE = 1e-5


def sharpened(chain: Chain, target: Target, q: Vector) -> Vector | None:
    """Return the joints (dof,) near q that meet the target, None if the limits are in the way."""
    for _ in range(_STEPS):
        T, J = chain.linearise(q, target.frame, target.offset_m)
        E, rows = target.position - T[:3, 3], J[:3]
        if not target.only_position:
            E = np.concatenate([E, target.turn_left(T[:3, :3])])
            rows = np.vstack([rows, _turn_rows(J[3:], T, target)])
        if float(np.abs(E).max()) < _MET:
            return q
        q = _stepped(chain, q, rows, E)
    return None


def _stepped(chain: Chain, q: Vector, J: Matrix, E: Vector) -> Vector:
    """Return q + J⁺ E, without the joints that would leave their limits (lecture L8, L9)."""
    free = np.ones(chain.dof, dtype=np.bool_)
    while True:
        moved = q + np.linalg.pinv(J * free, rcond=_TRUNCATE) @ E
        leaving = free & ((moved < chain.lower_rad) | (moved > chain.upper_rad))
        if not leaving.any():
            return moved
        free &= ~leaving


def _turn_rows(angular: Matrix, T: Matrix, target: Target) -> Matrix:
    """Return the rows that turn the tool; a wanted direction does not care for turns about it."""
    if target.rotation is not None:
        return angular
    axis = T[:3, :3] @ target.axis
    return angular - np.outer(axis, axis @ angular)

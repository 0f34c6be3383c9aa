"""What the other joints can do for one that does not get where it belongs."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector

__all__ = ["made_up"]

_ITERATIONS = 4
# Near a singularity a step would be large and of no use.
_DAMPING_M = 0.01
# A joint goes no further than this for another: a tool that tilts by more is another pose.
_FURTHEST_RAD = 0.05


def made_up(chain: Chain, target_m: Vector, q: Vector, held: Collection[str]) -> Vector | None:
    """Return joints (dof,) near ``q`` that bring the tip to its target while some are held.

    Damped least squares (lecture L8) with the columns of the held joints left out: the smallest
    step of the others.

    Args:
        chain: Base to tool.
        target_m: Where the tip shall be (3,), metres.
        q: Where the joints are (dof,), rad or m.
        held: Names of the joints that stay.

    Returns:
        The joints, or None where the others cannot halve what is missing.
    """
    free = np.array([name not in held for name in chain.names])
    low, high = chain.clip(q - _FURTHEST_RAD), chain.clip(q + _FURTHEST_RAD)
    found = q
    for _ in range(_ITERATIONS):
        T, J = chain.linearise(found)
        J = J[:3] * free
        normal = J @ J.T + _DAMPING_M**2 * np.eye(3)
        step = J.T @ np.linalg.solve(normal, target_m - T[:3, 3])
        found = np.where(free, np.clip(found + step, low, high), q)
    before, after = (float(np.linalg.norm(chain.forward(x)[:3, 3] - target_m)) for x in (q, found))
    return found if after < 0.5 * before else None

"""Whether a point that is far out of reach was meant in millimetres."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ikservo.ik.solver import solve
from ikservo.ik.target import Target
from ikservo.kinematics import Chain

__all__ = ["in_millimetres"]

_MM_PER_M = 1000.0
_FAR_M = 10.0  # further than any arm with servos reaches


def in_millimetres(chain: Chain, position_m: Sequence[float]) -> str:
    """Return a point with its numbers as millimetres, ``250mm 50mm 150mm``, if the arm reaches it.

    Args:
        chain: The arm.
        position_m: A point (3,) that the arm does not reach as metres.

    Returns:
        Nothing where the arm does not reach it as millimetres either.
    """
    point = np.asarray(position_m, dtype=float)
    if float(np.abs(point).max()) < _FAR_M:
        return ""
    reached = solve(chain, Target(point / _MM_PER_M)).reached
    return " ".join(f"{x:g}mm" for x in point) if reached else ""

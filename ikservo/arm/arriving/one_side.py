"""Play that is known is taken up: such joints come to their place from one side, from below."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ikservo.guard import Fence
from ikservo.kinematics.se3 import Vector

__all__ = ["drawn_back"]

# So far below its place a joint has certainly come through its play.
_MARGIN_TICKS = 3


def drawn_back(
    goals: Vector, moved: NDArray[np.bool_], backlash: Vector, fences: Sequence[Fence]
) -> Vector | None:
    """Return goals (n,) from which each joint with known play creeps up to its place.

    On which flank of its play a joint comes to rest depends on where it came from and on how it
    braked: the same reading, the play apart. So it goes below its place by its play, and up.

    Args:
        goals: What the servos are told at the end of a motion (n,), rad or m.
        moved: Whether each joint took part in it (n,).
        backlash: The play of each (n,), rad or m; 0 where it is not known.
        fences: What each may be told.

    Returns:
        The goals, inside the limits; None where no joint with known play has moved.
    """
    chosen = moved & (backlash > 0.0)
    if not chosen.any():
        return None
    margin = np.array([_MARGIN_TICKS * fence.joint_map.unit_per_tick for fence in fences])
    lowest = np.array([fence.positions[0] for fence in fences])
    below = np.maximum(goals - backlash - margin, np.minimum(lowest, goals))
    return np.where(chosen, below, goals)

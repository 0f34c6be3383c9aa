"""Whether the joints follow their goals: a jammed or dead joint is seen within three beats."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ikservo.errors import RefusedError
from ikservo.kinematics.se3 import Vector

__all__ = ["Following"]

_BEATS = 3


class Following:
    """Counts the beats in which a joint is further from its goal than lag and load explain.

    Args:
        names: The joints.
        most: How far each may be behind (n,), rad or m.
    """

    def __init__(self, names: Sequence[str], most: Vector) -> None:
        self._names, self._most = list(names), most
        self._behind = np.zeros(len(self._names), dtype=np.int64)

    def see(self, goals: Vector, measured: Vector) -> None:
        """Compare goals and measured joints (n,), rad or m, once a beat.

        Raises:
            RefusedError: A joint has been too far behind for three beats; names it.
        """
        behind = np.abs(goals - measured) > self._most
        self._behind = np.where(behind, self._behind + 1, 0)
        if (self._behind >= _BEATS).any():
            names = [self._names[i] for i in np.flatnonzero(self._behind >= _BEATS)]
            raise RefusedError(
                f"{', '.join(names)} does not follow its goal; the motion was stopped.",
                "Look for what blocks it, its cable, and its alarms: ikservo where",
            )

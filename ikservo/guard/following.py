"""Whether the joints follow their goals: a jammed or dead joint is seen within three beats."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from ikservo.errors import RefusedError
from ikservo.guard.fence import Fence
from ikservo.kinematics.se3 import Vector

__all__ = ["Following"]

_BEATS = 3
# A joint that only lags makes its motion slower before it comes so near the end of its look-ahead.
_SHARE = 0.9


class Following:
    """Counts the beats in which a joint is further from its goal than lag and load explain.

    Args:
        names: The joints.
        most: How far each may be behind (n,), rad or m.
    """

    def __init__(self, names: Sequence[str], most: Vector) -> None:
        self._names, self._most = list(names), most
        self._behind = np.zeros(len(self._names), dtype=np.int64)

    @classmethod
    def of(cls, fences: Sequence[Fence], speeds: Mapping[str, float] | None = None) -> Following:
        """Return a watch over joints whose goals keep the gate's look-ahead.

        Args:
            fences: Of the joints, in the order of the vectors (n,).
            speeds: Top speeds of the motion by joint, rad/s or m/s, as `Gate.run_at` takes them.
        """
        given = speeds or {}
        most = [
            _SHARE * f.lead_ticks(given.get(f.joint, f.speed)) * f.joint_map.unit_per_tick
            for f in fences
        ]
        return cls([fence.joint for fence in fences], np.array(most))

    def see(self, goals: Vector, measured: Vector) -> None:
        """Compare goals and measured joints (n,), rad or m, once a beat.

        Raises:
            RefusedError: A joint has been too far behind for three beats; names it.
        """
        # Written so that no number at all is behind, too.
        behind = ~(np.abs(goals - measured) <= self._most)
        self._behind = np.where(behind, self._behind + 1, 0)
        if (self._behind >= _BEATS).any():
            names = [self._names[i] for i in np.flatnonzero(self._behind >= _BEATS)]
            raise RefusedError(
                f"{', '.join(names)} does not follow its setpoint; motion stopped.",
                "Check for obstacles, its cable, and its alarms: ikservo where",
            )

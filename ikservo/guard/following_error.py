"""Stop a motion in which a joint does not follow its setpoint."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ikservo.errors import RefusedError
from ikservo.guard.driven_joint import DrivenJoint
from ikservo.kinematics.arrays import Vector

_MAX_CYCLES = 3  # a joint that is behind in this many consecutive cycles is blocked
# A lagging joint slows its motion down before its error comes this close to the maximum lead.
_ERROR_FRACTION = 0.9


class TrackingMonitor:
    """Count of the cycles in which a joint's following error exceeds its limit (n,), rad or m."""

    def __init__(self, names: Sequence[str], max_error: Vector) -> None:
        self._names, self._max_error = list(names), max_error
        self._behind = np.zeros(len(self._names), dtype=np.int64)

    @classmethod
    def for_limits(
        cls, limits: Sequence[DrivenJoint], speeds: Sequence[float] | None = None
    ) -> TrackingMonitor:
        """Return a monitor for joints; ``speeds``, rad/s or m/s, replace their own top speeds."""
        max_error = [
            _ERROR_FRACTION * driven.max_lead_ticks(speed) * driven.joint_map.unit_per_tick
            for driven, speed in zip(limits, speeds or [each.speed for each in limits], strict=True)
        ]
        return cls([limit.joint for limit in limits], np.array(max_error))

    @property
    def lagging(self) -> NDArray[np.bool_]:
        """Mask of the joints (n,) that have been too far behind for three cycles."""
        return self._behind >= _MAX_CYCLES

    def update(self, goals: Vector, measured: Vector) -> None:
        """Compare goals and measured joints (n,), rad or m, once per cycle.

        Raises:
            RefusedError: A joint has been too far behind for three cycles; the error names it.
        """
        # The comparison is written so that NaN counts as behind, too.
        behind = ~(np.abs(goals - measured) <= self._max_error)
        if not behind.any():
            self._behind.fill(0)
            return
        self._behind = np.where(behind, self._behind + 1, 0)
        if self.lagging.any():
            names = [self._names[i] for i in np.flatnonzero(self.lagging)]
            hint = "Check for obstacles, then the cable and the alarms of the joint: ikservo where"
            raise RefusedError(f"{_not_following(names)}; motion stopped.", hint)


def overweight_error(joints: Sequence[str]) -> RefusedError:
    """Return the error for joints that do not follow because their servos are too weak."""
    hint = "Switch torque off, fold the arm by hand to shorten its reach, then move again."
    too_weak = "the servo is too weak" if len(joints) == 1 else "their servos are too weak"
    found = f"{_not_following(joints)}; motion stopped because {too_weak}"
    return RefusedError(f"{found} to lift the arm from this posture.", hint)


def _not_following(joints: Sequence[str]) -> str:
    """Return a clause with the names of the joints that do not follow."""
    verb = "does not follow its setpoint" if len(joints) == 1 else "do not follow their setpoints"
    return f"{', '.join(joints)} {verb}"

"""On which side of a straight pose a path came, so that it goes back on the same."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from ikservo.kinematics.se3 import Vector

__all__ = ["Side"]

# A start this near to the last answer goes on from there.
_SAME_RAD = 0.01
# So far from a straight pose it is clear to which side it bends, and joints that are free besides
# are led back, too: at their limits they would be in the way later.
_BENT_RAD = 0.3


class Side:
    """What one path was like before its target went out of reach.

    Out of reach an arm stretches until it is straight, and straight it bends to either side as
    well. The walk to the first target within reach again therefore begins a little towards the
    last joints that reached theirs.

    Args:
        dof: How many joints there are.
    """

    def __init__(self, dof: int) -> None:
        self._last, self._bent = np.full(dof, np.nan), np.full(dof, np.nan)
        self._out = False

    def left_at(self, q0: ArrayLike) -> bool:
        """Return whether a path that stands at ``q0`` (dof,) is out of reach by now."""
        return self._out and self._goes_on(q0)

    def start(self) -> Vector:
        """Return where to walk from (dof,) to a target that is within reach again."""
        back: Vector = np.clip(self._bent - self._last, -_BENT_RAD, _BENT_RAD)
        return self._last + back

    def note(self, q0: ArrayLike, q: Vector, *, reached: bool) -> None:
        """Take the answer ``q`` (dof,) to a question of a path that stood at ``q0`` (dof,)."""
        if reached:
            self._bent[:] = q
        elif not self._goes_on(q0):
            self._bent[:] = q0
        self._last[:], self._out = q, not reached

    def _goes_on(self, q0: ArrayLike) -> bool:
        return bool(np.abs(np.asarray(q0) - self._last).max() <= _SAME_RAD)

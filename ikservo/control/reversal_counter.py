"""Count how often the errors of joints reverse."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ikservo.kinematics.arrays import Vector


class ReversalCounter:
    """Counter of error reversals in quick succession, which are frequent while a joint swings.

    Args:
        least: Smallest reversal (n,) that counts, rad or m; smaller reversals are noise and
            stiction.
        within_s: Longest time between two reversals; after a longer time, counting starts again.

    Attributes:
        count: Reversals of each joint (n,) in quick succession.
        width: Width of the error (n,) between the last two reversals, rad or m.
    """

    def __init__(self, least: Vector, within_s: float) -> None:
        self._least, self._within_s = least, within_s
        self.begin()

    def begin(self) -> None:
        """Discard all counts at the beginning of a motion."""
        self._extreme = np.zeros_like(self._least)
        self._grows = np.ones(len(self._least), dtype=bool)
        self._since_s = np.full_like(self._least, np.inf)
        self._reversal = np.zeros_like(self._least)
        self.count = np.zeros(len(self._least), dtype=int)
        self.width = np.zeros_like(self._least)

    def update(
        self, error: Vector, elapsed_s: float, *, fresh: NDArray[np.bool_] | bool
    ) -> NDArray[np.bool_]:
        """Process errors (n,), rad or m, of a cycle; return a mask of joints that just reversed."""
        self._since_s = self._since_s + elapsed_s
        beyond = np.where(self._grows, error - self._extreme, self._extreme - error)
        has_reversed = fresh & (beyond < -self._least)
        self.width = np.where(has_reversed, np.abs(self._extreme - self._reversal), self.width)
        self._reversal = np.where(has_reversed, self._extreme, self._reversal)
        self._extreme = np.where(has_reversed | (fresh & (beyond > 0.0)), error, self._extreme)
        self._grows = self._grows ^ has_reversed
        again = np.where(self._since_s < self._within_s, self.count + 1, 1)
        self.count = np.where(has_reversed, again, self.count)
        self._since_s = np.where(has_reversed, 0.0, self._since_s)
        return has_reversed

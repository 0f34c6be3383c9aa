"""How far a goal may go in a time: by the clock, not by how often somebody asks."""

from __future__ import annotations

import math

__all__ = ["LONGEST_ELAPSED_S", "Stride"]

# After a stall of the program goals may not leap by what the joint could have gone meanwhile.
LONGEST_ELAPSED_S = 0.05


class Stride:
    """The steps of one joint's goals.

    Goals are whole ticks, so that a step may be one tick longer than the speed says; but only the
    next ones pay for it, or many small steps would be faster than the speed.

    Args:
        ticks_s: The top speed, ticks a second.
    """

    def __init__(self, ticks_s: float) -> None:
        self._ticks_s = ticks_s
        self._spare = 1.0

    def most(self, elapsed_s: float) -> int:
        """Return the longest step for the time since the last one, ticks."""
        return math.floor(self._room(elapsed_s) + 1e-6)

    def take(self, step: int, elapsed_s: float) -> None:
        """Note a step that was taken."""
        self._spare = min(self._room(elapsed_s) - step, 1.0)

    def _room(self, elapsed_s: float) -> float:
        return self._spare + self._ticks_s * min(max(elapsed_s, 0.0), LONGEST_ELAPSED_S)

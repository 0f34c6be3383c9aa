"""Detect that joints are at rest, from their positions over a window of time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

_WINDOW_S = 0.5  # a hand that pauses for a shorter time has not let go
_NOISE_TICKS = 4  # noise of the encoders at rest


@dataclass(frozen=True, slots=True)
class StillnessDetector:
    """Recent positions by servo or joint: unwrapped ticks, rad or m.

    Attributes:
        window_s: Time in which nothing may move.
        tolerance: The variation of positions that counts as rest.
        readings: Times and positions within the window, and the last ones before it.
    """

    window_s: float = _WINDOW_S
    tolerance: float = _NOISE_TICKS
    readings: tuple[tuple[float, Mapping[int, float]], ...] = ()

    def add_reading(self, at_s: float, positions: Mapping[int, float]) -> StillnessDetector:
        """Add a reading and drop outdated ones."""
        start_s = at_s - self.window_s
        recent = [row for row in self.readings if row[0] > start_s]
        before = [row for row in self.readings if row[0] <= start_s][-1:]
        return replace(self, readings=(*before, *recent, (at_s, positions)))

    def restarted(self) -> StillnessDetector:
        """Return a detector without readings."""
        return replace(self, readings=())

    def is_at_rest(self) -> bool:
        """Check whether nothing has moved within the window."""
        if len(self.readings) < 3 or self.readings[-1][0] - self.readings[0][0] < self.window_s:
            return False
        return all(max(column) - min(column) <= self.tolerance for column in self._columns())

    def mean_ticks(self) -> dict[int, float]:
        """Compute the mean position of each servo over the window."""
        means = (sum(column) / len(column) for column in self._columns())
        return dict(zip(self.readings[-1][1], means, strict=True))

    def _columns(self) -> list[list[float]]:
        return [[positions[i] for _, positions in self.readings] for i in self.readings[-1][1]]

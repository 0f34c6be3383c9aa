"""Whether an arm is held still, and the middle of what was read meanwhile."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

__all__ = ["Stillness"]

_WINDOW_S = 0.5
_TREMBLE_TICKS = 4


@dataclass(frozen=True, slots=True)
class Stillness:
    """The unwrapped ticks of the last half second, by servo."""

    seen: tuple[tuple[float, Mapping[int, int]], ...] = ()

    def with_reading(self, at_s: float, ticks: Mapping[int, int]) -> Stillness:
        """Return it with one more reading; those older than half a second fall out."""
        kept = [row for row in self.seen if row[0] > at_s - _WINDOW_S]
        older = [row for row in self.seen if row[0] <= at_s - _WINDOW_S][-1:]
        return replace(self, seen=(*older, *kept, (at_s, ticks)))

    def still(self) -> bool:
        """Return whether nothing has moved for half a second."""
        if len(self.seen) < 3 or self.seen[-1][0] - self.seen[0][0] < _WINDOW_S:
            return False
        return all(max(column) - min(column) <= _TREMBLE_TICKS for column in self._columns())

    def middle(self) -> dict[int, float]:
        """Return the mean tick of each servo over the window."""
        means = (sum(column) / len(column) for column in self._columns())
        return dict(zip(self.seen[-1][1], means, strict=True))

    def _columns(self) -> list[list[int]]:
        return [[ticks[i] for _, ticks in self.seen] for i in self.seen[-1][1]]

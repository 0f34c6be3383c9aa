"""A loop timer with absolute deadlines."""

from __future__ import annotations

from collections.abc import Iterator

from ikservo.clock import Clock

__all__ = ["Rate"]


class Rate:
    """Yields every ``period_s``, at multiples of the period counted from the first cycle.

    A late cycle does not shift the later ones; missed cycles are skipped, not repeated in a burst.

    Attributes:
        cycles: The number of cycles.
    """

    def __init__(self, clock: Clock, period_s: float) -> None:
        self._clock, self._period_s = clock, period_s
        self.cycles = 0

    def __iter__(self) -> Iterator[float]:
        """Yield the seconds since the first cycle, at each cycle, without end."""
        start_s = self._clock.now_s()
        index = 0
        while True:
            due_s = start_s + index * self._period_s
            self._clock.sleep_until(due_s)
            elapsed_s = self._clock.now_s() - start_s
            self.cycles += 1
            yield elapsed_s
            index = self._next_cycle(index, self._clock.now_s() - start_s)

    def _next_cycle(self, index: int, elapsed_s: float) -> int:
        return max(index + 1, int(elapsed_s / self._period_s))

"""A loop timer with absolute deadlines."""

from __future__ import annotations

from collections.abc import Iterator

from ikservo.clock import Clock

__all__ = ["Rate"]


class Rate:
    """Beats every ``period_s``, at multiples of the period counted from the first beat.

    A beat that comes late does not move the later ones; beats that were missed altogether are
    left out, not made up for in a burst.

    Attributes:
        beats: How many beats there were.
    """

    def __init__(self, clock: Clock, period_s: float) -> None:
        self._clock, self._period_s = clock, period_s
        self.beats = 0

    def __iter__(self) -> Iterator[float]:
        """Yield the seconds since the first beat, at each beat, without end."""
        start_s = self._clock.now_s()
        index = 0
        while True:
            due_s = start_s + index * self._period_s
            self._clock.sleep_until(due_s)
            elapsed_s = self._clock.now_s() - start_s
            self.beats += 1
            yield elapsed_s
            index = self._next_cycle(index, self._clock.now_s() - start_s)

    def _next_cycle(self, index: int, elapsed_s: float) -> int:
        return max(index + 1, int(elapsed_s / self._period_s))

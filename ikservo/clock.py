"""The protocol of a clock, the real clock, and loops at a fixed rate."""

from __future__ import annotations

import time
from collections.abc import Iterator
from typing import Protocol


class Clock(Protocol):
    """Clock for all code that waits; a simulated bus provides a virtual one."""

    def now_s(self) -> float:
        """Return the monotonic time since an arbitrary start, in seconds."""
        ...

    def sleep_until(self, deadline_s: float) -> None:
        """Return once ``now_s()`` is at least ``deadline_s``."""
        ...


class RealClock:
    """The machine's monotonic clock; changes of the wall clock do not affect it."""

    def now_s(self) -> float:
        """Return the monotonic time in seconds."""
        return time.monotonic()

    def sleep_until(self, deadline_s: float) -> None:
        """Sleep in the kernel until the deadline; return at once if it has passed."""
        rest_s = deadline_s - time.monotonic()
        if rest_s > 0:
            time.sleep(rest_s)


class Rate:
    """Loop at a fixed rate, which yields at multiples of ``period_s`` since the first cycle.

    A late cycle does not shift later cycles; missed cycles are skipped, not made up for in a burst.

    Attributes:
        cycles: Number of cycles so far.
    """

    def __init__(self, clock: Clock, period_s: float) -> None:
        self._clock, self._period_s = clock, period_s
        self.cycles = 0

    def __iter__(self) -> Iterator[float]:
        """Yield the time since the first cycle, in seconds, once per cycle; never ends."""
        start_s = self._clock.now_s()
        index = 0
        while True:
            due_s = start_s + index * self._period_s
            self._clock.sleep_until(due_s)
            elapsed_s = self._clock.now_s() - start_s
            self.cycles += 1
            yield elapsed_s
            elapsed_s = self._clock.now_s() - start_s
            index = max(index + 1, int(elapsed_s / self._period_s))

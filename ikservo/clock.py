"""Time as an argument: the protocol of a clock, and the real one."""

from __future__ import annotations

import time
from typing import Protocol

__all__ = ["Clock", "RealClock"]


class Clock(Protocol):
    """The clock of all code that waits; a simulated bus has its own virtual one."""

    def now_s(self) -> float:
        """Return seconds since an arbitrary start; monotonic."""
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

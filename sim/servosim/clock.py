"""Time of the simulated bus: virtual (as fast as the processor allows) or the machine's own."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

__all__ = ["Clock", "RealClock", "VirtualClock"]


class Clock(Protocol):
    """Monotonic seconds, and a way to wait for them."""

    def now_s(self) -> float:
        """Return seconds since an arbitrary start; never runs backwards."""
        ...

    def sleep_until(self, deadline_s: float) -> None:
        """Return once ``now_s()`` is at least ``deadline_s``."""
        ...


class VirtualClock:
    """Time that stands still until somebody waits; waiting costs nothing.

    ``on_advance`` is told each new time: the world that goes by this clock.
    """

    def __init__(
        self, start_s: float = 0.0, on_advance: Callable[[float], None] | None = None
    ) -> None:
        self._now_s = start_s
        self._on_advance = on_advance

    def now_s(self) -> float:
        """Return the virtual time in seconds."""
        return self._now_s

    def sleep_until(self, deadline_s: float) -> None:
        """Jump to the deadline; stay where time is if that has passed."""
        if deadline_s <= self._now_s:
            return
        self._now_s = deadline_s
        if self._on_advance is not None:
            self._on_advance(deadline_s)


class RealClock:
    """The machine's monotonic clock."""

    def now_s(self) -> float:
        """Return the monotonic time in seconds."""
        return time.monotonic()

    def sleep_until(self, deadline_s: float) -> None:
        """Sleep in the kernel until the deadline; return at once if it has passed."""
        rest_s = deadline_s - time.monotonic()
        if rest_s > 0:
            time.sleep(rest_s)

"""Time of the simulated bus: virtual (as fast as the processor allows) or the machine's own."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Protocol

MIN_SLEEP_S = 0.001
# Virtual time catches up by at most this much. On a busy machine a displayed arm then moves slowly,
# but the simulator does not delay control cycles.
MAX_DELAY_S = 0.02


class Clock(Protocol):
    """A monotonic clock that can wait."""

    def now_s(self) -> float:
        """Return seconds since an arbitrary start; never runs backwards."""
        ...

    def sleep_until(self, deadline_s: float) -> None:
        """Wait until ``now_s()`` is at least ``deadline_s``."""
        ...


class VirtualClock:
    """Virtual time, which advances only when somebody waits; waiting takes no real time.

    ``on_advance`` is called with each new time, for the world on this clock.
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
        """Jump to the deadline, unless it has passed."""
        if deadline_s <= self._now_s:
            return
        self._now_s = deadline_s
        if self._on_advance is not None:
            self._on_advance(deadline_s)


class PacedClock(VirtualClock):
    """Virtual time that is not faster than the machine's, for display.

    Waits below a millisecond are accumulated, because the kernel cannot sleep that briefly. Delays
    up to ``MAX_DELAY_S`` are made up for at the next wait; longer ones stop virtual time.
    """

    def __init__(
        self, on_advance: Callable[[float], None] | None = None, machine: Clock | None = None
    ) -> None:
        super().__init__(0.0, on_advance)
        self._machine = machine or RealClock()
        self._start_s = self._machine.now_s()

    def sleep_until(self, deadline_s: float) -> None:
        """Advance virtual time and wait for the machine's."""
        machine_s = self._machine.now_s() - self._start_s
        excess_s = machine_s - max(deadline_s, self.now_s()) - MAX_DELAY_S
        if excess_s > 0.0:
            self._start_s += excess_s
            machine_s -= excess_s
        super().sleep_until(max(deadline_s, machine_s))
        if self.now_s() - machine_s >= MIN_SLEEP_S:
            self._machine.sleep_until(self._start_s + self.now_s())


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

"""The newest setpoint on its way from the program's thread to the control loop's."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator

from ikservo.arm.skills.tracking import Wish
from ikservo.clock import Clock, RealClock
from ikservo.guard import DEAD_MAN_TIMEOUT_S

__all__ = ["Mailbox"]

_LOOK_S = 0.1  # how soon a waiting sender notices that the control loop has ended


class Mailbox:
    """Holds the newest setpoint; the program puts, the control loop takes.

    Simulated time would run far ahead of a program that sends now and then. So it waits for the
    next setpoint of a sender with a rate, and keeps to the computer's time for one without.

    Args:
        clock: The arm's.
        period_s: Between two setpoints, for a sender that is paced; None for one that is not.
        ended: Whether the control loop has ended.
    """

    def __init__(self, clock: Clock, period_s: float | None, ended: Callable[[], bool]) -> None:
        self._clock, self._period_s, self._ended = clock, period_s, ended
        self._real = isinstance(clock, RealClock)
        self._changed = threading.Condition()
        self._setpoint: Wish | None = None
        self._taken_s, self._due_s = 0.0, 0.0
        self._late = self._closed = False
        self.put_count = 0
        self._taken_count = 0

    def put(self, setpoint: Wish) -> None:
        """Leave a setpoint in place of one that was not taken; return when the next is due.

        Without a period it returns at once.
        """
        with self._changed:
            self._setpoint, self._late = setpoint, False
            self.put_count += 1
            self._changed.notify_all()
            if self._period_s is not None:
                self._await_taken(self.put_count)
        if self._period_s is not None:
            self._await_due(self._period_s)

    def close(self) -> None:
        """Let the control loop end."""
        with self._changed:
            self._closed = True
            self._changed.notify_all()

    def await_first(self) -> bool:
        """Wait for a setpoint; return False where the mailbox was closed instead."""
        with self._changed:
            self._changed.wait_for(lambda: self._closed or self._setpoint is not None)
            return not self._closed

    def setpoints(self) -> Iterator[Wish | None]:
        """Yield the newest setpoint at each control cycle, or None; until closed."""
        begun_s, begun_wall_s = self._clock.now_s(), time.monotonic()
        self._taken_s, self._late = begun_s, False
        while not self._closed:
            now_s = self._clock.now_s()
            if not self._real and self._period_s is None:
                wall_s = time.monotonic() - begun_wall_s
                time.sleep(max(0.0, now_s - begun_s - wall_s))
            yield self._take(now_s)

    def _take(self, now_s: float) -> Wish | None:
        with self._changed:
            if self._holds_time(now_s):
                told = self._changed.wait_for(self._has_news, timeout=DEAD_MAN_TIMEOUT_S)
                self._late = not told
            setpoint, self._setpoint = self._setpoint, None
            if setpoint is not None:
                self._taken_s, self._taken_count = self._on_beat(now_s), self.put_count
            self._changed.notify_all()
            return setpoint

    def _holds_time(self, now_s: float) -> bool:
        """Return whether simulated time stands still until the next setpoint comes."""
        due = self._period_s is not None and now_s - self._taken_s >= self._period_s
        return due and not (self._real or self._late or self._has_news())

    def _on_beat(self, now_s: float) -> float:
        """Return the instant that a setpoint taken now belongs to; the sender's rate is kept."""
        planned_s = self._taken_s + (self._period_s or 0.0)
        on_time = self._period_s is not None and now_s - planned_s < self._period_s
        return planned_s if on_time else now_s

    def _has_news(self) -> bool:
        return self._closed or self._setpoint is not None

    def _await_taken(self, count: int) -> None:
        while self._taken_count < count and not self._ended():
            self._changed.wait(_LOOK_S)

    def _await_due(self, period_s: float) -> None:
        if self._real:
            self._due_s = max(self._due_s + period_s, self._clock.now_s())
            self._clock.sleep_until(self._due_s)
            return
        with self._changed:
            while self._clock.now_s() - self._taken_s < period_s and not self._ended():
                self._changed.wait(_LOOK_S)

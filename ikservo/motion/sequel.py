"""Two motions, the one after the other."""

from __future__ import annotations

from ikservo.motion.course import Course
from ikservo.motion.state import State

__all__ = ["Sequel"]


class Sequel:
    """A course that rests where the next one begins, and goes on with it.

    Args:
        first: What is done first; ends at rest.
        second: What is done then; begins at rest where the first one ends.
    """

    def __init__(self, first: Course, second: Course) -> None:
        self._first, self._second = first, second

    @property
    def duration_s(self) -> float:
        """Return how long both take."""
        return self._first.duration_s + self._second.duration_s

    def state(self, time_s: float) -> State:
        """Return position, velocity and acceleration (n,) at a time."""
        since_s = time_s - self._first.duration_s
        return self._first.state(time_s) if since_s < 0.0 else self._second.state(since_s)

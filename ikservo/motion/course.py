"""What every motion of joints is to whoever streams it."""

from __future__ import annotations

from typing import Protocol

from ikservo.motion.state import State

__all__ = ["Course"]


class Course(Protocol):
    """What joints do in time: a pure function of the seconds since it began."""

    @property
    def duration_s(self) -> float:
        """Return how long it takes; infinite for one that goes on until it is told to end."""
        ...

    def state(self, time_s: float) -> State:
        """Return position, velocity and acceleration (n,) at a time; at rest after its end."""
        ...

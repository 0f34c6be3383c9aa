"""The setpoints of a course: where the joints shall be now, also after a pause of the program."""

from __future__ import annotations

from ikservo.kinematics.se3 import Vector
from ikservo.motion import Course

__all__ = ["Setpoints"]

# Servos that stopped themselves stand a little behind the course: they are led back in this time.
_RETURN_S = 0.5


class Setpoints:
    """Turns the time that a motion may go on into positions of its course.

    After `lead_back` the course stands still, and setpoints go straight from where the joints
    were stopped to where the course is; then it goes on.

    Args:
        course: What the joints shall do.

    Attributes:
        time_s: Of the course.
    """

    def __init__(self, course: Course) -> None:
        self._course = course
        self.time_s = 0.0
        self._start: Vector | None = None
        self._returned_s = 0.0

    @property
    def ended(self) -> bool:
        """Return whether the course is at its end."""
        return self._start is None and self.time_s >= self._course.duration_s

    def lead_back(self, here: Vector) -> None:
        """Begin at ``here`` (n,), rad or m: the servos were stopped there."""
        self._start, self._returned_s = here, 0.0

    def next(self, gap_s: float) -> Vector:
        """Return the setpoint (n,), rad or m, after the motion has gone on by a time."""
        if self._start is None:
            self.time_s += gap_s
            return self._course.state(self.time_s).position
        self._returned_s += gap_s
        share = min(self._returned_s / _RETURN_S, 1.0)
        goal, start = self._course.state(self.time_s).position, self._start
        if share >= 1.0:
            self._start = None
        return start + share * (goal - start)

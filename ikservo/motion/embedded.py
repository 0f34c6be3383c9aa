"""A motion of some joints among others that stand still."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ikservo.kinematics.se3 import Vector
from ikservo.motion.course import Course
from ikservo.motion.state import State

__all__ = ["Embedded"]


class Embedded:
    """A course of n joints, of which some follow another course and the rest stay.

    Args:
        course: What those some do.
        columns: Which of the n joints they are.
        here: Where all joints are at the beginning (n,), rad or m.
    """

    def __init__(self, course: Course, columns: Sequence[int], here: Vector) -> None:
        self._course, self._columns, self._here = course, list(columns), here

    @property
    def duration_s(self) -> float:
        """Return how long it takes."""
        return self._course.duration_s

    def state(self, time_s: float) -> State:
        """Return position, velocity and acceleration (n,) at a time."""
        some = self._course.state(time_s)
        everything = State.rest(self._here)
        return State(
            self._set(everything.position, some.position),
            self._set(everything.velocity, some.velocity),
            self._set(everything.acceleration, some.acceleration),
        )

    def _set(self, values: Vector, some: Vector) -> Vector:
        whole: Vector = np.array(values)
        whole[self._columns] = some
        return whole

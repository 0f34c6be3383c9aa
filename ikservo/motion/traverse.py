"""A curve of joints gone through from rest to rest, as fast as the joints may."""

from __future__ import annotations

import math
from collections.abc import Sequence

from ikservo.kinematics.se3 import Vector
from ikservo.motion.curve import Curve
from ikservo.motion.pace import Pace
from ikservo.motion.state import State
from ikservo.motion.time_law import TimeLaw

__all__ = ["Traverse"]


class Traverse:
    """A course of n joints along a curve.

    Args:
        curve: The way of the joints.
        paces: The pace of each joint.
        top_speed: The fastest along the curve, in its own measure a second.
        marks: Distances at which the curve changes its nature, both ends included.
    """

    def __init__(
        self,
        curve: Curve,
        paces: Sequence[Pace],
        top_speed: float = math.inf,
        marks: Sequence[float] = (),
    ) -> None:
        self._curve = curve
        self._law = TimeLaw(curve, paces, top_speed, marks)

    @property
    def start(self) -> Vector:
        """Return where it begins (n,)."""
        return self._curve.at(0.0)[0]

    @property
    def goal(self) -> Vector:
        """Return where it ends (n,)."""
        return self._curve.at(self._curve.length)[0]

    @property
    def duration_s(self) -> float:
        """Return how long it takes."""
        return self._law.duration_s

    def at(self, time_s: float) -> Vector:
        """Return the joints (n,) at a time."""
        return self.state(time_s).position

    def state(self, time_s: float) -> State:
        """Return position, velocity and acceleration (n,) at a time."""
        distance, speed, acceleration = self._law.at(time_s)
        q, slope, bend = self._curve.at(distance)
        return State(q, slope * speed, bend * speed**2 + slope * acceleration)

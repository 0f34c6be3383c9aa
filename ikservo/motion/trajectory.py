"""Trajectories: the protocol, their samples, kinematic limits, subsets and concatenation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError
from ikservo.kinematics.arrays import Vector

__all__ = [
    "ConcatenatedTrajectory",
    "KinematicLimits",
    "SubsetTrajectory",
    "Trajectory",
    "TrajectoryPoint",
]


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryPoint:
    """Position, velocity and acceleration of n joints; rad, or m for prismatic ones."""

    position: Vector
    velocity: Vector
    acceleration: Vector

    @classmethod
    def at_rest(cls, position: ArrayLike) -> TrajectoryPoint:
        """Return the state of joints (n,) that stand still."""
        at = np.asarray(position, dtype=np.float64)
        return cls(at, np.zeros_like(at), np.zeros_like(at))


class Trajectory(Protocol):
    """What joints do in time: a pure function of the seconds since it began."""

    @property
    def duration_s(self) -> float:
        """Return how long it takes; infinite for one that goes on until it is told to end."""
        ...

    def state(self, time_s: float) -> TrajectoryPoint:
        """Return position, velocity and acceleration (n,) at a time; at rest after its end."""
        ...


@dataclass(frozen=True, slots=True)
class KinematicLimits:
    """How fast a joint may go; metres instead of radians for a prismatic joint.

    Raises:
        BadValueError: One of the three is not a positive number.
    """

    speed_rad_s: float
    acceleration_rad_s2: float
    jerk_rad_s3: float

    def __post_init__(self) -> None:
        for name in ("speed_rad_s", "acceleration_rad_s2", "jerk_rad_s3"):
            value = getattr(self, name)
            if not 0.0 < value < float("inf"):
                raise BadValueError(f"The pace's {name}", value, "a positive number")

    @property
    def stopping_time_s(self) -> float:
        """Return how long it takes from full speed to rest."""
        return (
            self.speed_rad_s / self.acceleration_rad_s2
            + self.acceleration_rad_s2 / self.jerk_rad_s3
        )

    def scale_units(self, factor: float) -> KinematicLimits:
        """Return the pace in units that are ``1 / factor`` as long: a slide's, a gear's."""
        return KinematicLimits(
            self.speed_rad_s * factor,
            self.acceleration_rad_s2 * factor,
            self.jerk_rad_s3 * factor,
        )


class SubsetTrajectory:
    """A course of n joints, of which some follow another course and the rest stay.

    Args:
        course: What those some do.
        columns: Which of the n joints they are.
        here: Where all joints are at the beginning (n,), rad or m.
    """

    def __init__(self, course: Trajectory, columns: Sequence[int], here: Vector) -> None:
        self._course, self._columns, self._here = course, list(columns), here

    @property
    def duration_s(self) -> float:
        """Return how long it takes."""
        return self._course.duration_s

    def state(self, time_s: float) -> TrajectoryPoint:
        """Return position, velocity and acceleration (n,) at a time."""
        some = self._course.state(time_s)
        everything = TrajectoryPoint.at_rest(self._here)
        return TrajectoryPoint(
            self._embed_values(everything.position, some.position),
            self._embed_values(everything.velocity, some.velocity),
            self._embed_values(everything.acceleration, some.acceleration),
        )

    def _embed_values(self, values: Vector, some: Vector) -> Vector:
        whole: Vector = np.array(values)
        whole[self._columns] = some
        return whole


class ConcatenatedTrajectory:
    """A course that rests where the next one begins, and goes on with it.

    Args:
        first: What is done first; ends at rest.
        second: What is done then; begins at rest where the first one ends.
    """

    def __init__(self, first: Trajectory, second: Trajectory) -> None:
        self._first, self._second = first, second

    @property
    def duration_s(self) -> float:
        """Return how long both take."""
        return self._first.duration_s + self._second.duration_s

    def state(self, time_s: float) -> TrajectoryPoint:
        """Return position, velocity and acceleration (n,) at a time."""
        since_s = time_s - self._first.duration_s
        return self._first.state(time_s) if since_s < 0.0 else self._second.state(since_s)

"""The trajectory protocol, samples, kinematic limits, subsets and concatenation."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError
from ikservo.kinematics.arrays import FrozenArrays, Vector


@dataclass(frozen=True, slots=True, eq=False)
class TrajectoryPoint(FrozenArrays):
    """Position, velocity and acceleration of n joints, in rad, or m for prismatic joints."""

    position: Vector
    velocity: Vector
    acceleration: Vector

    @classmethod
    def at_rest(cls, position: ArrayLike) -> TrajectoryPoint:
        """Compute the state of joints (n,) at rest."""
        at = np.asarray(position, dtype=np.float64)
        return cls(at, np.zeros_like(at), np.zeros_like(at))


class Trajectory(Protocol):
    """A joint motion in time: a pure function of the seconds since its start."""

    @property
    def duration_s(self) -> float:
        """The duration in seconds; infinite for a trajectory that runs until it is stopped."""
        ...

    def state(self, time_s: float) -> TrajectoryPoint:
        """Return position, velocity and acceleration (n,) at a time; at rest after the end."""
        ...


@dataclass(frozen=True, slots=True)
class KinematicLimits:
    """The limits of a joint's motion; metres instead of radians for a prismatic joint.

    Raises:
        BadValueError: One of the three limits is not a positive number.
    """

    speed_rad_s: float
    acceleration_rad_s2: float
    jerk_rad_s3: float

    def __post_init__(self) -> None:
        for name in ("speed_rad_s", "acceleration_rad_s2", "jerk_rad_s3"):
            value = getattr(self, name)
            if not 0.0 < value < float("inf"):
                raise BadValueError(f"The limit {name}", value, "a positive number")

    @property
    def stopping_time_s(self) -> float:
        """The time from full speed to rest."""
        return (
            self.speed_rad_s / self.acceleration_rad_s2
            + self.acceleration_rad_s2 / self.jerk_rad_s3
        )

    def scale_units(self, factor: float) -> KinematicLimits:
        """Return the limits in units that are ``1 / factor`` as long, for a slide or a gear."""
        return KinematicLimits(
            self.speed_rad_s * factor, self.acceleration_rad_s2 * factor, self.jerk_rad_s3 * factor
        )


class SubsetTrajectory:
    """A trajectory of n joints: some follow a trajectory of fewer joints, and the others hold.

    Args:
        trajectory: The trajectory of the moving joints.
        columns: The indices of the moving joints among the n joints.
        start: The start of all joints (n,), rad or m.
    """

    def __init__(self, trajectory: Trajectory, columns: Sequence[int], start: Vector) -> None:
        self._trajectory, self._columns, self._start = trajectory, list(columns), start

    @property
    def duration_s(self) -> float:
        """The duration of the motion in seconds."""
        return self._trajectory.duration_s

    def state(self, time_s: float) -> TrajectoryPoint:
        """Return position, velocity and acceleration (n,) at a time."""
        some = self._trajectory.state(time_s)
        all_joints = TrajectoryPoint.at_rest(self._start)
        return TrajectoryPoint(
            self._embed_values(all_joints.position, some.position),
            self._embed_values(all_joints.velocity, some.velocity),
            self._embed_values(all_joints.acceleration, some.acceleration),
        )

    def _embed_values(self, values: Vector, some: Vector) -> Vector:
        embedded: Vector = np.array(values)
        embedded[self._columns] = some
        return embedded


class ConcatenatedTrajectory:
    """A trajectory that continues with a second trajectory after the first has come to rest."""

    def __init__(self, first: Trajectory, second: Trajectory) -> None:
        self._first, self._second = first, second

    @property
    def duration_s(self) -> float:
        """The duration of both trajectories."""
        return self._first.duration_s + self._second.duration_s

    def state(self, time_s: float) -> TrajectoryPoint:
        """Return position, velocity and acceleration (n,) at a time."""
        since_s = time_s - self._first.duration_s
        return self._first.state(time_s) if since_s < 0.0 else self._second.state(since_s)

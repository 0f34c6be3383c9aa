"""The fastest jerk-limited motion of all joints from rest to rest, arriving together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from ruckig import InputParameter, Ruckig, Trajectory

from ikservo.errors import BadValueError
from ikservo.kinematics import finite_vector
from ikservo.kinematics.se3 import Vector

__all__ = ["JointMove", "Pace"]


@dataclass(frozen=True, slots=True)
class Pace:
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

    def scaled(self, factor: float) -> Pace:
        """Return the pace of a motion that takes ``1 / factor`` of the time at constant speed."""
        return Pace(
            self.speed_rad_s * factor,
            self.acceleration_rad_s2 * factor,
            self.jerk_rad_s3 * factor,
        )


class JointMove:
    """A motion of n joints, ready to be asked for any instant.

    Args:
        start: Where it begins, at rest (n,), rad or m.
        goal: Where it ends, at rest (n,).
        paces: The pace of each joint.

    Raises:
        BadValueError: A shape is wrong or a number is not finite.
    """

    def __init__(self, start: ArrayLike, goal: ArrayLike, paces: list[Pace]) -> None:
        n = len(paces)
        self.start = finite_vector(start, n, "The start of the motion")
        self.goal = finite_vector(goal, n, "The goal of the motion")
        self._trajectory = _fastest(self.start, self.goal, paces)

    @property
    def duration_s(self) -> float:
        """Return how long the motion takes."""
        return float(self._trajectory.duration)

    def at(self, time_s: float) -> Vector:
        """Return the joints (n,) at a time; the start before it begins, the goal after it ends."""
        if time_s <= 0.0:
            return self.start
        if time_s >= self.duration_s:
            return self.goal
        position, _, _ = self._trajectory.at_time(time_s)
        return np.array(position)


def _fastest(start: Vector, goal: Vector, paces: list[Pace]) -> Trajectory:
    wanted = InputParameter(len(paces))
    wanted.current_position = start.tolist()
    wanted.target_position = goal.tolist()
    wanted.max_velocity = [pace.speed_rad_s for pace in paces]
    wanted.max_acceleration = [pace.acceleration_rad_s2 for pace in paces]
    wanted.max_jerk = [pace.jerk_rad_s3 for pace in paces]
    trajectory = Trajectory(len(paces))
    Ruckig(len(paces)).calculate(wanted, trajectory)
    return trajectory

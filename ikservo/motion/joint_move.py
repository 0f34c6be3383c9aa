"""The fastest jerk-limited motions of all joints: to a goal arriving together, or to a stop."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from ruckig import ControlInterface, InputParameter, Ruckig, Synchronization, Trajectory

from ikservo.kinematics import finite_vector
from ikservo.kinematics.se3 import Vector
from ikservo.motion.pace import Pace
from ikservo.motion.state import State

__all__ = ["JointMove", "brake"]


class JointMove:
    """A motion of n joints to rest at a goal, ready to be asked for any instant.

    It may begin in the middle of another motion: a new goal is then reached without a stop and
    without a jump in position, velocity or acceleration.

    Args:
        start: Where it begins: joints at rest (n,), rad or m, or the state of a running motion.
        goal: Where it ends, at rest (n,).
        paces: The pace of each joint.

    Raises:
        BadValueError: A shape is wrong or a number is not finite.
    """

    def __init__(self, start: ArrayLike | State, goal: ArrayLike, paces: Sequence[Pace]) -> None:
        n = len(paces)
        begin = start if isinstance(start, State) else State.rest(start)
        finite_vector(begin.position, n, "The start of the motion")
        self.start = begin
        self.goal = finite_vector(goal, n, "The goal of the motion")
        self._top_speeds = [pace.speed_rad_s for pace in paces]
        wanted = _question(begin, paces)
        wanted.target_position = self.goal.tolist()
        self._trajectory = _answer(wanted, n)

    @property
    def duration_s(self) -> float:
        """Return how long the motion takes."""
        return float(self._trajectory.duration)

    def way(self, step_rad: float) -> list[Vector]:
        """Return joints (n,) along the motion, start and goal included.

        Args:
            step_rad: The furthest that any joint goes between two of them, rad or m.
        """
        fastest = max(abs(speed) for speed in self._top_speeds)
        looks = max(2, 1 + math.ceil(self.duration_s * fastest / step_rad))
        return [self.at(time_s) for time_s in np.linspace(0.0, self.duration_s, looks)]

    def at(self, time_s: float) -> Vector:
        """Return the joints (n,) at a time; the start before it begins, the goal after it ends."""
        return self.state(time_s).position

    def state(self, time_s: float) -> State:
        """Return position, velocity and acceleration (n,) at a time."""
        if time_s <= 0.0:
            return self.start
        if time_s >= self.duration_s:
            return State.rest(self.goal)
        return State(*(np.array(part) for part in self._trajectory.at_time(time_s)))


def brake(moving: State, paces: Sequence[Pace]) -> JointMove:
    """Return the motion that brings moving joints to rest as soon as their paces allow."""
    wanted = _question(moving, paces)
    wanted.control_interface = ControlInterface.Velocity
    wanted.synchronization = Synchronization.No
    stop = _answer(wanted, len(paces))
    rest, _, _ = stop.at_time(stop.duration)
    return _Stop(moving, np.array(rest), stop, wanted.max_velocity)


class _Stop(JointMove):
    """A motion whose end follows from its beginning."""

    def __init__(
        self, start: State, goal: Vector, trajectory: Trajectory, top_speeds: list[float]
    ) -> None:
        self.start, self.goal = start, goal
        self._trajectory, self._top_speeds = trajectory, top_speeds


def _question(start: State, paces: Sequence[Pace]) -> InputParameter:
    wanted = InputParameter(len(paces))
    wanted.current_position = start.position.tolist()
    wanted.current_velocity = start.velocity.tolist()
    wanted.current_acceleration = start.acceleration.tolist()
    # Joints in phase go straight from start to goal, where their paces and motion allow it.
    wanted.synchronization = Synchronization.Phase
    wanted.max_velocity = [pace.speed_rad_s for pace in paces]
    wanted.max_acceleration = [pace.acceleration_rad_s2 for pace in paces]
    wanted.max_jerk = [pace.jerk_rad_s3 for pace in paces]
    return wanted


def _answer(wanted: InputParameter, n: int) -> Trajectory:
    trajectory = Trajectory(n)
    Ruckig(n).calculate(wanted, trajectory)
    return trajectory

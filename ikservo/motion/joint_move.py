"""The fastest jerk-limited motions of all joints: to a goal arriving together, or to a stop."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from ruckig import (
    ControlInterface,
    InputParameter,
    Result,
    Ruckig,
    RuckigError,
    Synchronization,
    Trajectory,
)

from ikservo.errors import RefusedError
from ikservo.kinematics import finite_vector
from ikservo.kinematics.se3 import Vector
from ikservo.motion.extent import extent_of
from ikservo.motion.pace import Pace
from ikservo.motion.state import State

__all__ = ["JointMove", "brake"]

_LONGEST_REASON = 120


class JointMove:
    """A motion of n joints to a goal, ready to be asked for any instant.

    It may begin in the middle of another motion: a new goal is then reached without a stop and
    without a jump in position, velocity or acceleration.

    Args:
        start: Where it begins: joints at rest (n,), rad or m, or the state of a running motion.
        goal: Where it ends: joints at rest (n,), or the state in which another motion goes on.
        paces: The pace of each joint.
        together: Whether all joints arrive at once; else each as soon as it can.

    Raises:
        BadValueError: A shape is wrong or a number is not finite.
        RefusedError: No motion was found.
    """

    def __init__(
        self,
        start: ArrayLike | State,
        goal: ArrayLike | State,
        paces: Sequence[Pace],
        *,
        together: bool = True,
    ) -> None:
        n = len(paces)
        self.start = _checked(start, n, "start")
        self._end = _checked(goal, n, "goal")
        self.goal = self._end.position
        self._top_speeds = [pace.speed_rad_s for pace in paces]
        wanted = _question(self.start, paces)
        wanted.target_position = self.goal.tolist()
        wanted.target_velocity = self._end.velocity.tolist()
        wanted.target_acceleration = self._end.acceleration.tolist()
        # Joints in phase go straight from start to goal, where their paces and motion allow it.
        wanted.synchronization = Synchronization.Phase if together else Synchronization.No
        self._trajectory = _answer(wanted, n)

    @property
    def duration_s(self) -> float:
        """Return how long the motion takes."""
        return float(self._trajectory.duration)

    @property
    def extent(self) -> tuple[Vector, Vector]:
        """Return the lowest and the highest positions (n,) on the way."""
        return extent_of(self._trajectory)

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
            return self._end
        return State(*(np.array(part) for part in self._trajectory.at_time(time_s)))


def brake(moving: State, paces: Sequence[Pace]) -> JointMove:
    """Return the motion that brings moving joints to rest as soon as their paces allow.

    Raises:
        BadValueError: A shape is wrong or a number is not finite.
        RefusedError: No motion was found.
    """
    wanted = _question(_checked(moving, len(paces), "start"), paces)
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
        self.start, self.goal, self._end = start, goal, State.rest(goal)
        self._trajectory, self._top_speeds = trajectory, top_speeds


def _checked(at: ArrayLike | State, n: int, which: str) -> State:
    """Return a state of n joints; at rest, where only their positions are given."""
    if not isinstance(at, State):
        return State.rest(finite_vector(at, n, f"The {which} of the motion"))
    finite_vector(at.position, n, f"The {which} of the motion")
    finite_vector(at.velocity, n, f"The velocity at the {which} of the motion")
    finite_vector(at.acceleration, n, f"The acceleration at the {which} of the motion")
    return at


def _question(start: State, paces: Sequence[Pace]) -> InputParameter:
    wanted = InputParameter(len(paces))
    wanted.current_position = start.position.tolist()
    wanted.current_velocity = start.velocity.tolist()
    wanted.current_acceleration = start.acceleration.tolist()
    wanted.max_velocity = [pace.speed_rad_s for pace in paces]
    wanted.max_acceleration = [pace.acceleration_rad_s2 for pace in paces]
    wanted.max_jerk = [pace.jerk_rad_s3 for pace in paces]
    return wanted


def _answer(wanted: InputParameter, n: int) -> Trajectory:
    """Return the fastest trajectory.

    ruckig tells most failures by an exception and the others by its result; none may pass, for
    a trajectory that was not found is one to anywhere.
    """
    trajectory = Trajectory(n)
    try:
        result = Ruckig(n).calculate(wanted, trajectory)
    except RuckigError as error:
        raise _refusal(str(error)) from None
    if result not in (Result.Working, Result.Finished):
        raise _refusal(result.name)
    if not math.isfinite(trajectory.duration):
        raise _refusal("a duration without end")
    return trajectory


def _refusal(why: str) -> RefusedError:
    reason = " ".join(why.replace("[ruckig]", "").split())[:_LONGEST_REASON]
    return RefusedError(
        f"No motion to the goal was found ({reason}).",
        "Nothing was sent. Wait until the arm is at rest, then choose a nearer target.",
    )

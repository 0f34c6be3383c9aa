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

__all__ = ["JointMove", "RuckigMotion", "brake"]

_LONGEST_REASON = 120


class RuckigMotion:
    """A motion of n joints that has been computed; ready to be sampled at any time.

    Args:
        start: The state in which it begins.
        end: The state in which it ends, and stays.
        trajectory: The computed motion.
        top_speeds: The speed that each joint never exceeds, rad/s or m/s.

    Attributes:
        start: The state in which it begins.
        goal: Where it ends (n,), rad or m.
    """

    def __init__(
        self, start: State, end: State, trajectory: Trajectory, top_speeds: Sequence[float]
    ) -> None:
        self.start, self._end, self.goal = start, end, end.position
        self._trajectory, self._top_speeds = trajectory, list(top_speeds)

    @property
    def duration_s(self) -> float:
        """Return how long the motion takes."""
        return float(self._trajectory.duration)

    @property
    def extent(self) -> tuple[Vector, Vector]:
        """Return the lowest and the highest positions (n,) on the way."""
        return extent_of(self._trajectory)

    @property
    def top_speed(self) -> float:
        """Return the speed that no joint exceeds, rad/s or m/s."""
        return max(abs(speed) for speed in self._top_speeds)

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


class JointMove(RuckigMotion):
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
        begin, end = _checked(start, n, "start"), _checked(goal, n, "goal")
        wanted = _question(begin, paces)
        wanted.target_position = end.position.tolist()
        wanted.target_velocity = end.velocity.tolist()
        wanted.target_acceleration = end.acceleration.tolist()
        # Joints in phase go straight from start to goal, where their paces and motion allow it.
        wanted.synchronization = Synchronization.Phase if together else Synchronization.No
        super().__init__(begin, end, _answer(wanted, n), [pace.speed_rad_s for pace in paces])


def brake(moving: State, paces: Sequence[Pace]) -> RuckigMotion:
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
    return RuckigMotion(moving, State.rest(np.array(rest)), stop, wanted.max_velocity)


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

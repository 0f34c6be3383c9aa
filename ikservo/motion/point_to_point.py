"""Jerk-limited, synchronised joint motions from point to point, and stops from any state."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

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
from ikservo.kinematics.arrays import Vector, read_only
from ikservo.motion.trajectory import KinematicLimits, TrajectoryPoint


def position_bounds(trajectory: Trajectory) -> tuple[Vector, Vector]:
    """Compute the lowest and highest positions (n,) of a trajectory.

    ruckig's own ``position_extrema`` covers only the instants at which the jerk changes, but a
    joint may reverse between two such instants.
    """
    (profiles,) = trajectory.profiles
    lowest: list[float] = []
    highest: list[float] = []
    for profile in profiles:
        brake = profile.brake
        # The positions where the jerk changes, and those where the velocity is 0.
        reached = [
            *_segment_extremes(brake.t, brake.p, brake.v, brake.a, brake.j),
            *_segment_extremes(profile.t, profile.p, profile.v, profile.a, profile.j),
            profile.p[-1],
        ]
        lowest.append(min(reached))
        highest.append(max(reached))
    return np.array(lowest), np.array(highest)


def _segment_extremes(
    times_s: Sequence[float],
    p: Sequence[float],
    v: Sequence[float],
    a: Sequence[float],
    j: Sequence[float],
) -> Iterator[float]:
    for i, time_s in enumerate(times_s):
        if time_s > 0.0:
            for at_s in (0.0, time_s, *_zero_velocity_times(v[i], a[i], j[i], time_s)):
                yield p[i] + at_s * (v[i] + at_s * (a[i] / 2.0 + at_s * j[i] / 6.0))


def _zero_velocity_times(v: float, a: float, j: float, time_s: float) -> list[float]:
    """Compute the times between 0 and a time at which ``v + a t + j t² / 2 = 0``."""
    root = a * a - 2.0 * j * v
    if root < 0.0:
        return []
    # The larger root, then the other from the product of both, which is also exact for small j.
    sum_ = -(a + math.copysign(math.sqrt(root), a))
    found = [sum_ / j if j else math.inf, 2.0 * v / sum_ if sum_ else math.inf]
    return [at_s for at_s in found if 0.0 < at_s < time_s]


_MAX_REASON_CHARS = 120


class RuckigMotion:
    """A computed motion of n joints; can be sampled at any time.

    Args:
        start: The start state.
        end: The end state, which is also the state afterwards.
        trajectory: The computed motion.
        top_speeds: The maximum speed of each joint, rad/s or m/s.

    Attributes:
        goal: The end position (n,), rad or m.
    """

    def __init__(
        self,
        start: TrajectoryPoint,
        end: TrajectoryPoint,
        trajectory: Trajectory,
        top_speeds: Sequence[float],
    ) -> None:
        self.start, self._end, self.goal = start, end, end.position
        self._trajectory, self._top_speeds = trajectory, list(top_speeds)

    @property
    def duration_s(self) -> float:
        """Duration of the motion."""
        return float(self._trajectory.duration)

    @property
    def extent(self) -> tuple[Vector, Vector]:
        """Lowest and highest positions (n,) of the motion."""
        return position_bounds(self._trajectory)

    @property
    def top_speed(self) -> float:
        """The maximum speed of any joint, rad/s or m/s."""
        return max(abs(speed) for speed in self._top_speeds)

    def at(self, time_s: float) -> Vector:
        """Return the joints (n,) at a time; the start before the motion, the goal after its end."""
        return self.state(time_s).position

    def state(self, time_s: float) -> TrajectoryPoint:
        """Compute position, velocity and acceleration (n,) at a time."""
        if time_s <= 0.0:
            return self.start
        if time_s >= self.duration_s:
            return self._end
        return TrajectoryPoint(*map(read_only, self._trajectory.at_time(time_s)))


class JointMove(RuckigMotion):
    """A motion of n joints to a goal.

    The motion may start in the middle of another motion; the new goal is then reached without a
    stop and without a jump in position, velocity or acceleration.

    Args:
        start: The start: joints at rest (n,), rad or m, or the state of a running motion.
        goal: The end: joints at rest (n,), or a state in motion.
        limits: The kinematic limits of each joint.
        together: Whether all joints arrive at the same time; otherwise, each as soon as it can.

    Raises:
        BadValueError: A shape is wrong or a number is not finite.
        RefusedError: No motion was found.
    """

    def __init__(
        self,
        start: ArrayLike | TrajectoryPoint,
        goal: ArrayLike | TrajectoryPoint,
        limits: Sequence[KinematicLimits],
        *,
        together: bool = True,
    ) -> None:
        n = len(limits)
        begin, end = _check_state(start, n, "start"), _check_state(goal, n, "goal")
        parameters = _make_ruckig_input(begin, limits)
        parameters.target_position = end.position.tolist()
        parameters.target_velocity = end.velocity.tolist()
        parameters.target_acceleration = end.acceleration.tolist()
        # Phase-synchronised joints move straight from start to goal if limits and state allow it.
        parameters.synchronization = Synchronization.Phase if together else Synchronization.No
        try:
            trajectory = _calculate_trajectory(parameters, n)
        except RefusedError:
            if not begin.velocity.any():
                raise
            # ruckig fails to synchronise some joints that have almost arrived.
            parameters.synchronization = Synchronization.No
            trajectory = _calculate_trajectory(parameters, n)
        super().__init__(begin, end, trajectory, parameters.max_velocity)


def stop_trajectory(moving: TrajectoryPoint, limits: Sequence[KinematicLimits]) -> RuckigMotion:
    """Return the motion that brings moving joints to rest as soon as their limits allow.

    Raises:
        BadValueError: A shape is wrong or a number is not finite.
        RefusedError: No motion was found.
    """
    parameters = _make_ruckig_input(_check_state(moving, len(limits), "start"), limits)
    parameters.control_interface = ControlInterface.Velocity
    parameters.synchronization = Synchronization.No
    stop = _calculate_trajectory(parameters, len(limits))
    rest, _, _ = stop.at_time(stop.duration)
    return RuckigMotion(
        moving, TrajectoryPoint.at_rest(np.array(rest)), stop, parameters.max_velocity
    )


def _check_state(at: ArrayLike | TrajectoryPoint, n: int, which: str) -> TrajectoryPoint:
    """Return the state of n joints, at rest if only positions are given."""
    if not isinstance(at, TrajectoryPoint):
        return TrajectoryPoint.at_rest(finite_vector(at, n, f"The {which} of the motion"))
    finite_vector(at.position, n, f"The {which} of the motion")
    finite_vector(at.velocity, n, f"The velocity at the {which} of the motion")
    finite_vector(at.acceleration, n, f"The acceleration at the {which} of the motion")
    return at


def _make_ruckig_input(start: TrajectoryPoint, limits: Sequence[KinematicLimits]) -> InputParameter:
    parameters = InputParameter(len(limits))
    parameters.current_position = start.position.tolist()
    parameters.current_velocity = start.velocity.tolist()
    parameters.current_acceleration = start.acceleration.tolist()
    parameters.max_velocity = [limit.speed_rad_s for limit in limits]
    parameters.max_acceleration = [limit.acceleration_rad_s2 for limit in limits]
    parameters.max_jerk = [limit.jerk_rad_s3 for limit in limits]
    return parameters


def _calculate_trajectory(parameters: InputParameter, n: int) -> Trajectory:
    """Return the fastest trajectory.

    ruckig reports most failures by an exception and the others by its result; all are checked,
    because an invalid trajectory could lead anywhere.
    """
    trajectory = Trajectory(n)
    try:
        result = Ruckig(n).calculate(parameters, trajectory)
    except RuckigError as error:
        raise _ruckig_error(str(error)) from None
    if result not in (Result.Working, Result.Finished):
        raise _ruckig_error(result.name)
    if not math.isfinite(trajectory.duration):
        raise _ruckig_error("an infinite duration")
    return trajectory


def _ruckig_error(why: str) -> RefusedError:
    reason = " ".join(why.replace("[ruckig]", "").split())[:_MAX_REASON_CHARS]
    hint = "Nothing was sent. Wait until the arm is at rest, then choose a nearer target."
    return RefusedError(f"No motion to the goal was found ({reason}).", hint)

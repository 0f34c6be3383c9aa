"""A straight line of the tool: joints re-solved along it, continuous, in the time they need."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError, UnreachableError
from ikservo.ik import Solver
from ikservo.kinematics import Chain, finite_vector
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.motion.joint_move import JointMove
from ikservo.motion.pace import Pace
from ikservo.motion.spline import Spline
from ikservo.motion.state import State

__all__ = ["ToolLine"]

# Between two solved points the spline strays from the line by far less than their distance.
_STEP_M = 0.002
_LEAST_POINTS = 5
# A millimetre that takes a joint this far runs past a singularity or to another branch.
_STEEPEST_RAD_M = 60.0


class ToolLine:
    """A motion of the joints of a chain that takes its tip along a straight line, rest to rest.

    Args:
        chain: The arm; ``start`` is inside its limits.
        start: The joints where the line begins (dof,), rad or m.
        goal_m: Where the tip goes (3,), metres, base frame.
        paces: The pace of each joint.
        speed_m_s: The fastest the tip may go.

    Raises:
        UnreachableError: Some point of the line is out of reach, or can only be reached by a jump
            of the joints; carries the last point before it.
        BadValueError: No three finite numbers, or no positive speed.
    """

    def __init__(
        self,
        chain: Chain,
        start: ArrayLike,
        goal_m: ArrayLike,
        paces: Sequence[Pace],
        speed_m_s: float = 0.25,
    ) -> None:
        if not 0.0 < speed_m_s < math.inf:
            raise BadValueError("The speed of the tool", speed_m_s, "a positive number of m/s")
        self.start = finite_vector(start, chain.dof, "The start of the line")
        from_m = chain.forward(self.start)[:3, 3]
        to_m = finite_vector(goal_m, 3, "The end of the line")
        self.length_m = float(np.linalg.norm(to_m - from_m))
        joints = _along(chain, self.start, from_m, to_m, self.length_m)
        self.goal = joints[-1]
        self._spline = Spline(np.linspace(0.0, max(self.length_m, 1e-9), len(joints)), joints)
        self._law = JointMove([0.0], [self.length_m], [_fitting(self._spline, paces, speed_m_s)])

    @property
    def duration_s(self) -> float:
        """Return how long the motion takes."""
        return self._law.duration_s

    def at(self, time_s: float) -> Vector:
        """Return the joints (dof,) at a time."""
        return self.state(time_s).position

    def state(self, time_s: float) -> State:
        """Return position, velocity and acceleration (dof,) at a time."""
        return _chained(self._spline, self._law.state(time_s))


def _along(chain: Chain, start: Vector, from_m: Vector, to_m: Vector, length_m: float) -> Matrix:
    """Return joints (n, dof) at even distances along the line, each solved from the one before."""
    count = max(_LEAST_POINTS, 1 + math.ceil(length_m / _STEP_M))
    solver, joints = Solver(chain), [start]
    T = np.eye(4)
    for share in np.linspace(0.0, 1.0, count)[1:]:
        T[:3, 3] = from_m + share * (to_m - from_m)
        q, reached = solver(T, joints[-1])
        step_m = length_m / (count - 1)
        if not reached or float(np.abs(q - joints[-1]).max()) > _STEEPEST_RAD_M * step_m + 1e-6:
            raise UnreachableError(T[:3, 3].tolist(), chain.forward(joints[-1])[:3, 3].tolist())
        joints.append(np.array(q))
    return np.array(joints)


def _fitting(spline: Spline, paces: Sequence[Pace], speed_m_s: float) -> Pace:
    """Return the pace along the line at which no joint exceeds its own.

    A path that is gone through k times slower has speeds k times, accelerations k² times and jerks
    k³ times as low; so one trial tells how much slower it has to be.
    """
    trial = Pace(speed_m_s, 4.0 * speed_m_s, 40.0 * speed_m_s)
    law = JointMove([0.0], [spline.length], [trial])
    times_s = np.linspace(0.0, law.duration_s, 400)
    states = [_chained(spline, law.state(time_s)) for time_s in times_s]
    velocity = np.abs([state.velocity for state in states]).max(axis=0)
    acceleration = np.array([state.acceleration for state in states])
    jerk = np.abs(np.diff(acceleration, axis=0)).max(axis=0) / max(times_s[1], 1e-9)
    slower = 1.0
    for i, pace in enumerate(paces):
        slower = max(
            slower,
            velocity[i] / pace.speed_rad_s,
            math.sqrt(np.abs(acceleration[:, i]).max() / pace.acceleration_rad_s2),
            math.cbrt(jerk[i] / pace.jerk_rad_s3) if times_s[1] else 0.0,
        )
    slower *= _MARGIN if slower > 1.0 else 1.0
    return Pace(
        trial.speed_rad_s / slower,
        trial.acceleration_rad_s2 / slower**2,
        trial.jerk_rad_s3 / slower**3,
    )


# The trial looks at 400 instants; between them a joint may be a little faster.
_MARGIN = 1.05


def _chained(spline: Spline, along: State) -> State:
    """Return the joints' state for a place, speed and acceleration along the line."""
    s, speed, acceleration = (
        float(part[0]) for part in (along.position, along.velocity, along.acceleration)
    )
    q, slope, bend = spline.at(s)
    return State(q, slope * speed, bend * speed**2 + slope * acceleration)

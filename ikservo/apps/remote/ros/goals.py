"""Goals from ROS 2 as setpoints: joint trajectories, twists of the tool, poses."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, ClassVar, Protocol

import numpy as np

from ikservo.arm.target_tracking import CartesianOrJointTarget
from ikservo.errors import BadValueError, InputError, RefusedError
from ikservo.guard.dead_man import DEAD_MAN_TIMEOUT_S
from ikservo.ik import Target
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import exp_so3, quaternion_to_matrix

_MAX_POINTS = 10_000
_MAX_DURATION_S = 3600.0
_MAX_AHEAD_S = 1.0
_CLOCKS = "Synchronise the clocks of both machines."
_MAX_M_S, _MAX_RAD_S = 0.5, math.pi
_LEAD_M = 0.03  # lead of a twist's target, in addition to its travel in the dead time


class MotionGoal(Protocol):
    """A goal that provides setpoints until it has ended.

    Attributes:
        arrives: Whether the arm must arrive at the last setpoint; otherwise, it only brakes.
    """

    arrives: ClassVar[bool]

    def delay(self, now_s: float) -> None:
        """Record that the arm is not ready yet; the goal does not begin before now."""
        ...

    def setpoint(self, now_s: float, tip_m: Vector) -> CartesianOrJointTarget:
        """Return the present setpoint; ``tip_m`` (3,) is the measured tip."""
        ...

    def has_ended(self, now_s: float) -> bool:
        """Check whether the last setpoint was given."""
        ...


def check_age(stamp: Any, now_s: float) -> None:  # noqa: ANN401  # builtin_interfaces/Time
    """Refuse a message that is too old; accept one without a time stamp.

    Raises:
        RefusedError: The message is too old, or from the future.
    """
    sent_s = stamp.sec + 1e-9 * stamp.nanosec
    if sent_s == 0.0:
        return
    age_s = now_s - sent_s
    if age_s > DEAD_MAN_TIMEOUT_S:
        raise RefusedError(f"The message is {age_s:.1f} s old and was dropped.", _CLOCKS)
    if age_s < -_MAX_AHEAD_S:
        raise RefusedError(
            f"The time stamp of the message is {-age_s:.1f} s in the future.", _CLOCKS
        )


class TrajectoryGoal:
    """Goal along a joint trajectory: cubic if velocities are given, otherwise linear.

    Args:
        names: The joints (m).
        times_s: Times (k,) from the start, increasing from 0.
        positions: Positions (k, m), rad or m.
        velocities: Velocities (k, m), or None.
        start_s: The time of the start.
    """

    arrives: ClassVar[bool] = True

    def __init__(
        self,
        names: Sequence[str],
        times_s: Vector,
        positions: Matrix,
        velocities: Matrix | None,
        start_s: float,
    ) -> None:
        self._names, self._times_s, self._positions = tuple(names), times_s, positions
        self._velocities, self._start_s = velocities, start_s

    def delay(self, now_s: float) -> None:
        """Restart the trajectory at the present time."""
        self._start_s = now_s

    def setpoint(self, now_s: float, tip_m: Vector) -> dict[str, float]:
        """Return the present positions by joint."""
        return self.positions_at(now_s)

    def late_s(self, now_s: float) -> float:
        """Compute the time since the end; negative before the end."""
        return now_s - self._start_s - float(self._times_s[-1])

    def positions_at(self, now_s: float) -> dict[str, float]:
        """Compute the desired positions, rad or m by name; after the end, the last positions."""
        elapsed_s = min(max(now_s - self._start_s, 0.0), float(self._times_s[-1]))
        k = int(np.searchsorted(self._times_s[1:-1], elapsed_s, side="right"))
        span_s = float(self._times_s[k + 1] - self._times_s[k])
        u = (elapsed_s - float(self._times_s[k])) / span_s
        start, end = self._positions[k], self._positions[k + 1]
        if self._velocities is None:
            values = start + u * (end - start)
        else:  # cubic Hermite polynomials
            v0, v1 = span_s * self._velocities[k], span_s * self._velocities[k + 1]
            values = start + u * v0 + u**2 * (3 * (end - start) - 2 * v0 - v1)
            values = values + u**3 * (2 * (start - end) + v0 + v1)
        return dict(zip(self._names, values.tolist(), strict=True))

    def has_ended(self, now_s: float) -> bool:
        """Check whether the trajectory has ended."""
        return self.late_s(now_s) >= 0.0


def trajectory_goal(
    message: Any,  # noqa: ANN401  # trajectory_msgs/msg/JointTrajectory
    present: Mapping[str, float],
    limits: Mapping[str, tuple[float, float]],
    now_s: float,
) -> TrajectoryGoal:
    """Return the goal in a message with at least one point; the motion starts at ``now_s``.

    Raises:
        InputError: The message names an unknown joint, or its points cannot be used.
        RefusedError: A point is beyond a limit.
    """
    names, points = tuple(message.joint_names), message.points
    unknown = [name for name in names if name not in present]
    if unknown or not names or len(set(names)) != len(names):
        raise BadValueError(
            "The list of joints", f"{(unknown or names)!r}", f"each once: {', '.join(present)}"
        )
    if len(points) > _MAX_POINTS:
        raise BadValueError(
            "The trajectory", f"{len(points)} points long", f"at most {_MAX_POINTS} points"
        )
    times_s = np.array([p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in points])
    if times_s[0] < 0.0 or not (np.diff(times_s) > 0.0).all() or times_s[-1] > _MAX_DURATION_S:
        expected = f"times that increase from at least 0 to at most {_MAX_DURATION_S:.0f} s"
        raise BadValueError("time_from_start", "not increasing", expected)
    positions = _rows(points, "positions", len(names))
    has_velocities = all(len(point.velocities) for point in points)
    velocities = _rows(points, "velocities", len(names)) if has_velocities else None
    _check_limits(names, positions, limits)
    start = np.array([present[name] for name in names])
    if times_s[0] > 0.0:
        times_s, positions = np.append(0.0, times_s), np.vstack([start, positions])
        velocities = None if velocities is None else np.vstack([0.0 * start, velocities])
    elif len(times_s) == 1:  # one point: move there as fast as allowed
        times_s, positions = np.array([0.0, 1e-3]), np.vstack([positions, positions])
        velocities = None
    return TrajectoryGoal(names, times_s, positions, velocities, now_s)


def _rows(points: Sequence[Any], field: str, n: int) -> Matrix:
    rows = [np.asarray(getattr(point, field), dtype=np.float64) for point in points]
    for number, row in enumerate(rows, start=1):
        if row.shape != (n,) or not np.isfinite(row).all():
            raise BadValueError(f"{field} of point {number}", row.tolist(), f"{n} finite numbers")
    return np.array(rows)


def _check_limits(
    names: Sequence[str], positions: Matrix, limits: Mapping[str, tuple[float, float]]
) -> None:
    for column, name in enumerate(names):
        lower, upper = limits[name]
        beyond = np.flatnonzero(
            (positions[:, column] < lower - 1e-3) | (positions[:, column] > upper + 1e-3)
        )
        if len(beyond):
            found = positions[beyond[0], column]
            raise RefusedError(
                f"{name} at point {beyond[0] + 1} is {found:.3f}, outside {lower:.3f} to "
                f"{upper:.3f}.",
                "Nothing moved.",
            )


class TwistGoal:
    """Goal that moves the tool at the commanded velocity until there is no command for 0.3 s.

    Args:
        T: The start pose, T_base_tip (4, 4).
        now_s: The time of the start.
    """

    arrives: ClassVar[bool] = False

    def __init__(self, T: Matrix, now_s: float) -> None:
        self._T, self._last_s, self._received_s = T.copy(), now_s, -math.inf
        self._linear_m_s, self._angular_rad_s = np.zeros(3), np.zeros(3)
        self._turns = False

    def delay(self, now_s: float) -> None:
        """Start moving now."""
        self._last_s = now_s

    def update(
        self, linear_m_s: Vector, angular_rad_s: Vector, *, of_tool: bool, now_s: float
    ) -> None:
        """Set the velocity (3,) and angular velocity (3,), in the base frame or the tool frame.

        Raises:
            BadValueError: A number is not finite or too large.
        """
        for what, values, largest in (
            ("The linear velocity", linear_m_s, _MAX_M_S),
            ("The angular velocity", angular_rad_s, _MAX_RAD_S),
        ):
            if not np.linalg.norm(values) <= largest:
                raise BadValueError(
                    what, values.tolist(), f"a finite vector of at most {largest:g}"
                )
        R = self._T[:3, :3] if of_tool else np.eye(3)
        self._linear_m_s, self._angular_rad_s = R @ linear_m_s, R @ angular_rad_s
        self._turns = self._turns or bool(self._angular_rad_s.any())
        self._received_s = now_s

    def setpoint(self, now_s: float, tip_m: Vector) -> CartesianOrJointTarget:
        """Compute the target of the tool: a point, or a pose once a rotation was commanded."""
        until_s = min(now_s, self._received_s + DEAD_MAN_TIMEOUT_S)
        dt_s, self._last_s = max(0.0, until_s - self._last_s), now_s
        speed_m_s = float(np.linalg.norm(self._linear_m_s))
        moved_m = self._T[:3, 3] + dt_s * self._linear_m_s
        if np.linalg.norm(moved_m - tip_m) <= _LEAD_M + DEAD_MAN_TIMEOUT_S * speed_m_s:
            self._T[:3, 3] = moved_m
        self._T[:3, :3] = exp_so3(dt_s * self._angular_rad_s) @ self._T[:3, :3]
        return self._T.copy() if self._turns else Target(self._T[:3, 3].copy())

    def has_ended(self, now_s: float) -> bool:
        """Check whether no command has arrived for too long."""
        return now_s - self._received_s > DEAD_MAN_TIMEOUT_S


class PoseGoal:
    """Goal that moves the tool to a pose (4, 4) or a point."""

    arrives: ClassVar[bool] = True

    def __init__(self, target: CartesianOrJointTarget) -> None:
        self._target = target

    def delay(self, now_s: float) -> None:
        """Do nothing, because a pose has no start time."""

    def setpoint(self, now_s: float, tip_m: Vector) -> CartesianOrJointTarget:
        """Return the pose."""
        return self._target

    def has_ended(self, now_s: float) -> bool:
        """Return True, because the sender of the setpoints watches the arrival."""
        return True


def pose_goal(pose: Any) -> PoseGoal:  # noqa: ANN401  # geometry_msgs/msg/Pose
    """Return the goal that a pose message asks for; a zero quaternion leaves the orientation free.

    Raises:
        InputError: A number is not finite, or the quaternion has no direction.
    """
    point = np.array([pose.position.x, pose.position.y, pose.position.z])
    q = np.array([getattr(pose.orientation, name) for name in "wxyz"])
    if not (np.isfinite(point).all() and np.isfinite(q).all()):
        raise InputError("The pose contains a number that is not finite.", "Nothing moved.")
    if not q.any():
        return PoseGoal(Target(point))
    length = float(np.linalg.norm(q))
    if not 0.9 < length < 1.1:
        raise BadValueError(
            "The quaternion", q.tolist(), "a quaternion of length 1, or zeros for any orientation"
        )
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = quaternion_to_matrix(q / length), point
    return PoseGoal(T)

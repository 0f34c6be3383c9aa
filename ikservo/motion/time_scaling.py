"""Time scaling of paths, as fast as joint velocity and acceleration limits allow."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise
from operator import itemgetter

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError
from ikservo.kinematics import finite_vector
from ikservo.kinematics.arrays import Vector
from ikservo.motion.path import BlendedPath, Path
from ikservo.motion.point_to_point import JointMove
from ikservo.motion.trajectory import KinematicLimits, TrajectoryPoint

# Fractions to try of the speed that the second and third derivatives allow; the rest of the limits
# is left for acceleration along the curve.
_SPEED_FRACTIONS = (0.4, 0.6, 0.85)
_ZONES = (1, 2, 5, 13, 34)  # numbers of equal zones to try; each zone has its own speed limit
_MIN_LENGTH = 1e-6  # a shorter curve counts as a point
_ROUNDING = 1e-6  # margin to the limits for rounding, as a fraction
_UNBOUNDED = 1e6  # limit of speed along a curve that hardly moves any joint


@dataclass(frozen=True, slots=True)
class _SpeedZone:
    """A section of the curve with its own limits on speed, acceleration and jerk."""

    begin: float
    end: float
    speed: float
    acceleration: float
    jerk: float


class TimeScaling:
    """Fast time scaling of a curve, from rest to rest.

    With the distance s, the joints have ``q̇ = q' ṡ``, ``q̈ = q'' ṡ² + q' s̈`` and ``q⃛ = q''' ṡ³ +
    3 q'' ṡ s̈ + q' s⃛``. The curve is cut into zones; in each zone, bounds on the curve's
    derivatives give the speed, acceleration and jerk along the curve that keep those of the joints
    inside the limits, at every instant and not only at samples. The acceleration along the curve is
    zero at the ends of every zone. Several divisions into zones are tried, and the fastest is used.

    Args:
        curve: The curve.
        limits: The kinematic limits of each of the curve's n values.
        top_speed: The maximum speed along the curve.
        marks: Distances at which the type of the curve changes, including both ends.
    """

    def __init__(
        self,
        curve: Path,
        limits: Sequence[KinematicLimits],
        top_speed: float = math.inf,
        marks: Sequence[float] = (),
    ) -> None:
        self._moves = [JointMove([curve.length], [curve.length], [KinematicLimits(1.0, 1.0, 1.0)])]
        if curve.length > _MIN_LENGTH:
            bounds, best_s = _PathAccelerationBounds(limits, top_speed), math.inf
            candidates = list[tuple[float, tuple[_SpeedZone, ...], list[float]]]()
            # Zones between equal distances, and between the curve's marks.
            choices = [np.linspace(0.0, curve.length, count + 1).tolist() for count in _ZONES]
            if len(marks) > 1:
                choices.append([0.0, *marks[1:-1], curve.length])
            for edges in choices:
                stretches = [
                    bounds.make_zones(*ends, curve.max_derivatives(*ends))
                    for ends in pairwise(edges)
                ]
                for zones in zip(*stretches, strict=True):
                    speeds = _speeds_between(zones)
                    shortest_s = sum(map(_shortest_s, zones, speeds, speeds[1:]))
                    candidates.append((shortest_s, zones, speeds))
            for shortest_s, zones, speeds in sorted(candidates, key=itemgetter(0)):
                if shortest_s >= best_s:
                    break
                moves = [
                    JointMove(
                        _passing_state(zone.begin, first),
                        _passing_state(zone.end, second),
                        [KinematicLimits(zone.speed, zone.acceleration, zone.jerk)],
                    )
                    for zone, (first, second) in zip(zones, pairwise(speeds), strict=True)
                ]
                taken_s = sum(move.duration_s for move in moves)
                if taken_s < best_s:
                    self._moves, best_s = moves, taken_s
        self._begins = [0.0, *accumulate(move.duration_s for move in self._moves)]

    @property
    def duration_s(self) -> float:
        """The duration of the motion in seconds."""
        return self._begins[-1]

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Return distance, speed and acceleration along the curve at a time."""
        last = len(self._moves) - 1
        i = min(max(bisect_right(self._begins, time_s) - 1, 0), last)
        state = self._moves[i].state(time_s - self._begins[i])
        return float(state.position[0]), float(state.velocity[0]), float(state.acceleration[0])


class _PathAccelerationBounds:
    """Bounds on the derivatives of a curve, and the limits along it that they allow."""

    def __init__(self, limits: Sequence[KinematicLimits], top_speed: float) -> None:
        self._speeds = np.array([limit.speed_rad_s for limit in limits]) * (1.0 - _ROUNDING)
        self._accelerations = np.array([p.acceleration_rad_s2 for p in limits]) * (1.0 - _ROUNDING)
        self._jerks = np.array([limit.jerk_rad_s3 for limit in limits]) * (1.0 - _ROUNDING)
        self._top = top_speed

    def make_zones(
        self, begin: float, end: float, derivatives: tuple[Vector, Vector, Vector]
    ) -> Iterator[_SpeedZone]:
        """Yield the limits of a zone for each fraction of the limits that the curvature may use."""
        slope, bend, twist = derivatives
        fastest = min(self._top, _min_ratio(self._speeds, slope))
        by_bend = _min_ratio(self._accelerations, bend)
        by_twist = _min_ratio(self._jerks, twist)
        for fraction in _SPEED_FRACTIONS:
            speed = min(fastest, math.sqrt(fraction * by_bend), math.cbrt(fraction * by_twist))
            remaining = self._jerks - twist * speed**3
            acceleration = min(
                _min_ratio(self._accelerations - bend * speed**2, slope),
                _min_ratio(0.5 * remaining, 3.0 * bend * speed),
            )
            jerk = _min_ratio(remaining - 3.0 * bend * speed * acceleration, slope)
            yield _SpeedZone(begin, end, speed, acceleration, jerk)


def _min_ratio(limit: Vector, by: Vector) -> float:
    """Compute the minimum of ``limit / by``, ignoring values of ``by`` that are zero."""
    pairs = zip(limit.tolist(), by.tolist(), strict=True)  # few values: NumPy takes longer
    return min((a / b for a, b in pairs if b > a / _UNBOUNDED), default=_UNBOUNDED)


def _shortest_s(zone: _SpeedZone, first: float, second: float) -> float:
    """Compute the time through a zone, from one speed to another, for unlimited jerk."""
    length, most = zone.end - zone.begin, zone.speed
    peak = math.sqrt(zone.acceleration * length + 0.5 * (first * first + second * second))
    if peak <= most:
        return (2.0 * peak - first - second) / zone.acceleration
    ramps = (most - first) ** 2 + (most - second) ** 2
    return (length + 0.5 * ramps / zone.acceleration) / most


def _passing_state(distance: float, speed: float) -> TrajectoryPoint:
    return TrajectoryPoint(np.array([distance]), np.array([speed]), np.zeros(1))


def _speeds_between(zones: Sequence[_SpeedZone]) -> list[float]:
    """Compute the speeds at the edges of zones: zero at the ends, else the largest possible."""
    speeds = [0.0, *(min(a.speed, b.speed) for a, b in pairwise(zones)), 0.0]
    for i, zone in enumerate(zones):
        speeds[i + 1] = _reachable_speed(zone, speeds[i], speeds[i + 1])
    for i, zone in reversed(list(enumerate(zones))):
        speeds[i] = _reachable_speed(zone, speeds[i + 1], speeds[i])
    return speeds


def _reachable_speed(zone: _SpeedZone, speed: float, goal_speed: float) -> float:
    """Compute the speed up to ``goal_speed`` that can be reached in the zone's length."""
    length = (1.0 - _ROUNDING) * (zone.end - zone.begin)
    if goal_speed <= speed or _required_distance(zone, speed, goal_speed) <= length:
        return goal_speed
    low, high = speed, goal_speed
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if _required_distance(zone, speed, middle) <= length else (low, middle)
        )
    return low


def _required_distance(zone: _SpeedZone, speed: float, goal_speed: float) -> float:
    """Compute the distance from one speed to a higher one, with acceleration 0 at both ends."""
    gain, knee = goal_speed - speed, zone.acceleration**2 / zone.jerk
    if gain < knee:
        time_s = 2.0 * math.sqrt(gain / zone.jerk)
    else:
        time_s = gain / zone.acceleration + zone.acceleration / zone.jerk
    return 0.5 * (speed + goal_speed) * time_s


class PathTrajectory:
    """A trajectory of n joints along a curve.

    Args:
        curve: The path of the joints.
        limits: The kinematic limits of each joint.
        top_speed: The maximum speed along the curve, in the unit of its distance per second.
        marks: Distances at which the type of the curve changes, including both ends.
    """

    def __init__(
        self,
        curve: Path,
        limits: Sequence[KinematicLimits],
        top_speed: float = math.inf,
        marks: Sequence[float] = (),
    ) -> None:
        self._curve = curve
        self._law = TimeScaling(curve, limits, top_speed, marks)

    @property
    def start(self) -> Vector:
        """The joints (n,) at the start."""
        return self._curve.at(0.0)[0]

    @property
    def goal(self) -> Vector:
        """The joints (n,) at the end."""
        return self._curve.at(self._curve.length)[0]

    @property
    def duration_s(self) -> float:
        """The duration of the motion in seconds."""
        return self._law.duration_s

    def at(self, time_s: float) -> Vector:
        """Return the joints (n,) at a time."""
        return self.state(time_s).position

    def state(self, time_s: float) -> TrajectoryPoint:
        """Return position, velocity and acceleration (n,) at a time."""
        distance, speed, acceleration = self._law.at(time_s)
        q, slope, bend = self._curve.at(distance)
        return TrajectoryPoint(q, slope * speed, bend * speed**2 + slope * acceleration)


class JointWaypointTrajectory(PathTrajectory):
    """A motion of n joints from point to point that rests only at its end.

    Between two waypoints all joints are synchronised. Every joint passes each waypoint except the
    last within 3/8 of the blend. No joint leaves the range of the waypoints.

    Args:
        start: The start, at rest (n,), rad or m.
        points: The waypoints (k, n).
        limits: The kinematic limits of each joint.
        blends: The distance from each of the k - 1 inner points, in the joint that moves furthest,
            at which the motion leaves the straight path; at most half of this path is used. One
            number is used for all points.

    Raises:
        BadValueError: A shape is wrong, a number is not finite, or a blend is not positive.
    """

    def __init__(
        self,
        start: ArrayLike,
        points: Sequence[ArrayLike],
        limits: Sequence[KinematicLimits],
        blends: float | Sequence[float],
    ) -> None:
        begin = finite_vector(start, len(limits), "The start of the path")
        corners = [finite_vector(point, len(limits), "A point of the path") for point in points]
        if not corners:
            raise BadValueError("The path", "empty", "at least one point")
        inner = len(corners) - 1
        radii = [blends] * inner if isinstance(blends, float | int) else list(blends)
        if len(radii) != inner:
            raise BadValueError("The list of blends", radii, f"{inner} distances")
        path = BlendedPath(np.array([begin, *corners]), radii, np.inf)
        super().__init__(path, limits, marks=path.breakpoints)

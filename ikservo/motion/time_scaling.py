"""Time scaling of paths: as fast as joint velocity and acceleration limits allow."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError
from ikservo.kinematics import finite_vector
from ikservo.kinematics.arrays import Vector
from ikservo.motion.path import BlendedPath, Path
from ikservo.motion.point_to_point import JointMove
from ikservo.motion.trajectory import KinematicLimits, TrajectoryPoint

__all__ = ["JointWaypointTrajectory", "PathTrajectory", "TimeScaling"]


# Shares of what bends and twists allow that are tried for the speed; the rest is left for
# acceleration along the curve.
_SPEED_FRACTIONS = (0.4, 0.6, 0.85)
_ZONES = (1, 2, 5, 13, 34)
_MIN_LENGTH = 1e-6
_ROUNDING = 1e-6
_UNBOUNDED = 1e6


@dataclass(frozen=True, slots=True)
class _SpeedZone:
    """A stretch of the curve with limits of its own along it."""

    begin: float
    end: float
    speed: float
    acceleration: float
    jerk: float

    @property
    def kinematic_limits(self) -> KinematicLimits:
        return KinematicLimits(self.speed, self.acceleration, self.jerk)


class TimeScaling:
    """Goes through a curve from rest to rest in little time.

    With s the distance, the joints do ``q̇ = q' ṡ``, ``q̈ = q'' ṡ² + q' s̈`` and
    ``q⃛ = q''' ṡ³ + 3 q'' ṡ s̈ + q' s⃛``. The curve is cut into zones; in each, bounds on its
    derivatives give the speed, acceleration and jerk along it that keep all three inside the
    paces, at every instant and not only where somebody looks. Zones are passed without
    acceleration at their ends. Several ways to cut are tried, and the fastest is taken.

    Args:
        curve: What to go through.
        paces: The pace of each of its n values.
        top_speed: The fastest along the curve.
        marks: Distances at which the curve changes its nature, both ends included.
    """

    def __init__(
        self,
        curve: Path,
        paces: Sequence[KinematicLimits],
        top_speed: float = math.inf,
        marks: Sequence[float] = (),
    ) -> None:
        self._moves = [JointMove([curve.length], [curve.length], [KinematicLimits(1.0, 1.0, 1.0)])]
        if curve.length > _MIN_LENGTH:
            tried = (
                _zone_moves(
                    list(
                        _make_zones(curve, _PathAccelerationBounds(paces, top_speed), edges, share)
                    )
                )
                for edges in _zone_edges(curve.length, marks)
                for share in _SPEED_FRACTIONS
            )
            self._moves = min(tried, key=lambda moves: sum(m.duration_s for m in moves))
        self._begins = [0.0, *accumulate(move.duration_s for move in self._moves)]

    @property
    def duration_s(self) -> float:
        """Return how long it takes."""
        return self._begins[-1]

    def at(self, time_s: float) -> tuple[float, float, float]:
        """Return distance, speed and acceleration along the curve at a time."""
        last = len(self._moves) - 1
        i = min(max(bisect_right(self._begins, time_s) - 1, 0), last)
        state = self._moves[i].state(time_s - self._begins[i])
        return float(state.position[0]), float(state.velocity[0]), float(state.acceleration[0])


class _PathAccelerationBounds:
    """What paces allow along a curve whose derivatives are bounded."""

    def __init__(self, paces: Sequence[KinematicLimits], top_speed: float) -> None:
        self._speeds = np.array([pace.speed_rad_s for pace in paces]) * (1.0 - _ROUNDING)
        self._accelerations = np.array([p.acceleration_rad_s2 for p in paces]) * (1.0 - _ROUNDING)
        self._jerks = np.array([pace.jerk_rad_s3 for pace in paces]) * (1.0 - _ROUNDING)
        self._top = top_speed

    def make_zone(self, curve: Path, begin: float, end: float, share: float) -> _SpeedZone:
        """Return the limits along a stretch, its speed a share of what bends and twists allow."""
        slope, bend, twist = curve.max_derivatives(begin, end)
        speed = min(
            self._top,
            _min_ratio(self._speeds, slope),
            math.sqrt(share * _min_ratio(self._accelerations, bend)),
            math.cbrt(share * _min_ratio(self._jerks, twist)),
        )
        left = self._jerks - twist * speed**3
        acceleration = min(
            _min_ratio(self._accelerations - bend * speed**2, slope),
            _min_ratio(0.5 * left, 3.0 * bend * speed),
        )
        jerk = _min_ratio(left - 3.0 * bend * speed * acceleration, slope)
        return _SpeedZone(begin, end, speed, acceleration, jerk)


def _min_ratio(most: Vector, by: Vector) -> float:
    """Return the least of ``most / by``; what is not moved at all binds nothing."""
    moved = by > most / _UNBOUNDED
    return float((most[moved] / by[moved]).min()) if moved.any() else _UNBOUNDED


def _zone_edges(length: float, marks: Sequence[float]) -> Iterator[list[float]]:
    """Yield ways to cut a curve into zones: at equal distances, and at its marks."""
    for count in _ZONES:
        yield np.linspace(0.0, length, count + 1).tolist()
    if len(marks) > 1:
        yield [0.0, *marks[1:-1], length]


def _make_zones(
    curve: Path, bounds: _PathAccelerationBounds, edges: Sequence[float], share: float
) -> Iterator[_SpeedZone]:
    for begin, end in pairwise(edges):
        yield bounds.make_zone(curve, begin, end, share)


def _zone_moves(zones: Sequence[_SpeedZone]) -> list[JointMove]:
    """Return the motion through each zone."""
    speeds = _speeds_between(zones)
    return [
        JointMove(
            _passing_state(zone.begin, first),
            _passing_state(zone.end, second),
            [zone.kinematic_limits],
        )
        for zone, (first, second) in zip(zones, pairwise(speeds), strict=True)
    ]


def _passing_state(distance: float, speed: float) -> TrajectoryPoint:
    return TrajectoryPoint(np.array([distance]), np.array([speed]), np.zeros(1))


def _speeds_between(zones: Sequence[_SpeedZone]) -> list[float]:
    """Return the speeds at the zones' edges: rest at both ends, else what both sides allow."""
    speeds = [0.0, *(min(a.speed, b.speed) for a, b in pairwise(zones)), 0.0]
    for i, zone in enumerate(zones):
        speeds[i + 1] = _reachable_speed(zone, speeds[i], speeds[i + 1])
    for i, zone in reversed(list(enumerate(zones))):
        speeds[i] = _reachable_speed(zone, speeds[i + 1], speeds[i])
    return speeds


def _reachable_speed(zone: _SpeedZone, speed: float, wanted: float) -> float:
    """Return the speed up to ``wanted`` that the zone's length allows to come to."""
    length = (1.0 - _ROUNDING) * (zone.end - zone.begin)
    if wanted <= speed or _required_distance(zone, speed, wanted) <= length:
        return wanted
    low, high = speed, wanted
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if _required_distance(zone, speed, middle) <= length else (low, middle)
        )
    return low


def _required_distance(zone: _SpeedZone, speed: float, wanted: float) -> float:
    """Return the distance to come from one speed to a higher one, acceleration 0 at both ends."""
    gain, knee = wanted - speed, zone.acceleration**2 / zone.jerk
    if gain < knee:
        time_s = 2.0 * math.sqrt(gain / zone.jerk)
    else:
        time_s = gain / zone.acceleration + zone.acceleration / zone.jerk
    return 0.5 * (speed + wanted) * time_s


class PathTrajectory:
    """A course of n joints along a curve.

    Args:
        curve: The way of the joints.
        paces: The pace of each joint.
        top_speed: The fastest along the curve, in its own measure a second.
        marks: Distances at which the curve changes its nature, both ends included.
    """

    def __init__(
        self,
        curve: Path,
        paces: Sequence[KinematicLimits],
        top_speed: float = math.inf,
        marks: Sequence[float] = (),
    ) -> None:
        self._curve = curve
        self._law = TimeScaling(curve, paces, top_speed, marks)

    @property
    def start(self) -> Vector:
        """Return where it begins (n,)."""
        return self._curve.at(0.0)[0]

    @property
    def goal(self) -> Vector:
        """Return where it ends (n,)."""
        return self._curve.at(self._curve.length)[0]

    @property
    def duration_s(self) -> float:
        """Return how long it takes."""
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

    Between two way-points all joints keep step; at each but the last every joint passes at no
    more than 3/8 of the blend. No joint leaves the range that the way-points span.

    Args:
        start: Where it begins, at rest (n,), rad or m.
        points: Where it goes (k, n).
        paces: The pace of each joint.
        blends: How far from each of the k - 1 inner points, in the joint that goes furthest, the
            straight way is left; half of it at most. One number for all of them alike.

    Raises:
        BadValueError: A shape is wrong, a number is not finite, or a blend is not positive.
    """

    def __init__(
        self,
        start: ArrayLike,
        points: Sequence[ArrayLike],
        paces: Sequence[KinematicLimits],
        blends: float | Sequence[float],
    ) -> None:
        begin = finite_vector(start, len(paces), "The start of the route")
        corners = [finite_vector(point, len(paces), "A point of the route") for point in points]
        if not corners:
            raise BadValueError("The route", "empty", "at least one point")
        inner = len(corners) - 1
        radii = [blends] * inner if isinstance(blends, float | int) else list(blends)
        if len(radii) != inner:
            raise BadValueError("The list of blends", radii, f"{inner} of them")
        path = BlendedPath(np.array([begin, *corners]), radii, np.inf)
        super().__init__(path, paces, marks=path.breakpoints)

"""How far along a curve one is at each instant, so that no joint ever exceeds its pace."""

from __future__ import annotations

import math
from bisect import bisect_right
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import accumulate, pairwise

import numpy as np

from ikservo.kinematics.se3 import Vector
from ikservo.motion.curve import Curve
from ikservo.motion.joint_move import JointMove
from ikservo.motion.pace import Pace
from ikservo.motion.state import State

__all__ = ["TimeLaw"]

# Shares of what bends and twists allow that are tried for the speed; the rest is left for
# acceleration along the curve.
_SHARES = (0.4, 0.6, 0.85)
_ZONES = (1, 2, 5, 13, 34)
_SHORTEST = 1e-6
_ROUNDING = 1e-6
_HUGE = 1e6


@dataclass(frozen=True, slots=True)
class _Zone:
    """A stretch of the curve with limits of its own along it."""

    begin: float
    end: float
    speed: float
    acceleration: float
    jerk: float

    @property
    def pace(self) -> Pace:
        return Pace(self.speed, self.acceleration, self.jerk)


class TimeLaw:
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
        curve: Curve,
        paces: Sequence[Pace],
        top_speed: float = math.inf,
        marks: Sequence[float] = (),
    ) -> None:
        self._moves = [JointMove([curve.length], [curve.length], [Pace(1.0, 1.0, 1.0)])]
        if curve.length > _SHORTEST:
            tried = (
                _moves(list(_zones(curve, _Bounds(paces, top_speed), edges, share)))
                for edges in _cuts(curve.length, marks)
                for share in _SHARES
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


class _Bounds:
    """What paces allow along a curve whose derivatives are bounded."""

    def __init__(self, paces: Sequence[Pace], top_speed: float) -> None:
        self._speeds = np.array([pace.speed_rad_s for pace in paces]) * (1.0 - _ROUNDING)
        self._accelerations = np.array([p.acceleration_rad_s2 for p in paces]) * (1.0 - _ROUNDING)
        self._jerks = np.array([pace.jerk_rad_s3 for pace in paces]) * (1.0 - _ROUNDING)
        self._top = top_speed

    def zone(self, curve: Curve, begin: float, end: float, share: float) -> _Zone:
        """Return the limits along a stretch, its speed a share of what bends and twists allow."""
        slope, bend, twist = curve.steepest(begin, end)
        speed = min(
            self._top,
            _least(self._speeds, slope),
            math.sqrt(share * _least(self._accelerations, bend)),
            math.cbrt(share * _least(self._jerks, twist)),
        )
        left = self._jerks - twist * speed**3
        acceleration = min(
            _least(self._accelerations - bend * speed**2, slope),
            _least(0.5 * left, 3.0 * bend * speed),
        )
        jerk = _least(left - 3.0 * bend * speed * acceleration, slope)
        return _Zone(begin, end, speed, acceleration, jerk)


def _least(most: Vector, by: Vector) -> float:
    """Return the least of ``most / by``; what is not moved at all binds nothing."""
    moved = by > most / _HUGE
    return float((most[moved] / by[moved]).min()) if moved.any() else _HUGE


def _cuts(length: float, marks: Sequence[float]) -> Iterator[list[float]]:
    """Yield ways to cut a curve into zones: at equal distances, and at its marks."""
    for count in _ZONES:
        yield np.linspace(0.0, length, count + 1).tolist()
    if len(marks) > 1:
        yield [0.0, *marks[1:-1], length]


def _zones(curve: Curve, bounds: _Bounds, edges: Sequence[float], share: float) -> Iterator[_Zone]:
    for begin, end in pairwise(edges):
        yield bounds.zone(curve, begin, end, share)


def _moves(zones: Sequence[_Zone]) -> list[JointMove]:
    """Return the motion through each zone."""
    speeds = _speeds_between(zones)
    return [
        JointMove(_passing(zone.begin, first), _passing(zone.end, second), [zone.pace])
        for zone, (first, second) in zip(zones, pairwise(speeds), strict=True)
    ]


def _passing(distance: float, speed: float) -> State:
    return State(np.array([distance]), np.array([speed]), np.zeros(1))


def _speeds_between(zones: Sequence[_Zone]) -> list[float]:
    """Return the speeds at the zones' edges: rest at both ends, else what both sides allow."""
    speeds = [0.0, *(min(a.speed, b.speed) for a, b in pairwise(zones)), 0.0]
    for i, zone in enumerate(zones):
        speeds[i + 1] = _reached(zone, speeds[i], speeds[i + 1])
    for i, zone in reversed(list(enumerate(zones))):
        speeds[i] = _reached(zone, speeds[i + 1], speeds[i])
    return speeds


def _reached(zone: _Zone, speed: float, wanted: float) -> float:
    """Return the speed up to ``wanted`` that the zone's length allows to come to."""
    length = (1.0 - _ROUNDING) * (zone.end - zone.begin)
    if wanted <= speed or _needed(zone, speed, wanted) <= length:
        return wanted
    low, high = speed, wanted
    for _ in range(30):
        middle = 0.5 * (low + high)
        low, high = (middle, high) if _needed(zone, speed, middle) <= length else (low, middle)
    return low


def _needed(zone: _Zone, speed: float, wanted: float) -> float:
    """Return the distance to come from one speed to a higher one, acceleration 0 at both ends."""
    gain, knee = wanted - speed, zone.acceleration**2 / zone.jerk
    if gain < knee:
        time_s = 2.0 * math.sqrt(gain / zone.jerk)
    else:
        time_s = gain / zone.acceleration + zone.acceleration / zone.jerk
    return 0.5 * (speed + wanted) * time_s

"""How far a trajectory of ruckig goes, exactly: also where a joint turns round on its way."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence

import numpy as np
from ruckig import Profile, Trajectory

from ikservo.kinematics.se3 import Vector

__all__ = ["extent_of"]


def extent_of(trajectory: Trajectory) -> tuple[Vector, Vector]:
    """Return the lowest and the highest positions (n,) of a trajectory.

    ruckig's own ``position_extrema`` knows only where its jerk changes, and a joint that turns
    round does so between two such instants.
    """
    (profiles,) = trajectory.profiles
    reached = [list(_turns(profile)) for profile in profiles]
    return np.array([min(each) for each in reached]), np.array([max(each) for each in reached])


def _turns(profile: Profile) -> Iterator[float]:
    """Yield the positions where the jerk changes, and those where the joint stands."""
    brake = profile.brake
    yield from _stretches(brake.t, brake.p, brake.v, brake.a, brake.j)
    yield from _stretches(profile.t, profile.p, profile.v, profile.a, profile.j)
    yield profile.p[-1]


def _stretches(
    times_s: Sequence[float],
    p: Sequence[float],
    v: Sequence[float],
    a: Sequence[float],
    j: Sequence[float],
) -> Iterator[float]:
    for i, time_s in enumerate(times_s):
        if time_s > 0.0:
            for at_s in (0.0, time_s, *_standing(v[i], a[i], j[i], time_s)):
                yield p[i] + at_s * (v[i] + at_s * (a[i] / 2.0 + at_s * j[i] / 6.0))


def _standing(v: float, a: float, j: float, time_s: float) -> list[float]:
    """Return when ``v + a t + j t² / 2`` is 0, between 0 and a time."""
    root = a * a - 2.0 * j * v
    if root < 0.0:
        return []
    # The larger root first, then the other by their product: exact also where j is next to 0.
    sum_ = -(a + math.copysign(math.sqrt(root), a))
    found = [sum_ / j if j else math.inf, 2.0 * v / sum_ if sum_ else math.inf]
    return [at_s for at_s in found if 0.0 < at_s < time_s]

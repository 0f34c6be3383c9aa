"""What a course will be like: the way of the tip, what sets its time, which limits come close."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ikservo.arm.planning.plan import NearLimit
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.model.joint_limits import near_distance
from ikservo.motion import Course, Pace

__all__ = ["near_limits", "path_length_m", "states_of", "time_setters"]

_LOOKS = 200
# A joint that uses this share of its pace at some instant is one that sets the time.
_FULL = 0.98


def states_of(course: Course) -> tuple[Matrix, Matrix, Matrix]:
    """Return positions, velocities and accelerations (k, n) along a course."""
    states = [course.state(time_s) for time_s in np.linspace(0.0, course.duration_s, _LOOKS)]
    return (
        np.array([state.position for state in states]),
        np.array([state.velocity for state in states]),
        np.array([state.acceleration for state in states]),
    )


def path_length_m(chain: Chain, joints: Matrix) -> float:
    """Return the way of the tip along the chain's joints (k, dof)."""
    tips = chain.forward(joints)[:, :3, 3]
    return float(np.linalg.norm(np.diff(tips, axis=0), axis=1).sum())


def time_setters(
    velocity: Matrix, acceleration: Matrix, paces: Sequence[Pace], names: Sequence[str]
) -> list[str]:
    """Return which joints go as fast as they may at some instant, in words.

    Args:
        velocity: Along the way (k, n).
        acceleration: Along the way (k, n).
        paces: The pace of each joint.
        names: Their names.
    """
    words: list[str] = []
    for i, (name, pace) in enumerate(zip(names, paces, strict=True)):
        if float(np.abs(velocity[:, i]).max()) >= _FULL * pace.speed_rad_s:
            words.append(f"{name} at its top speed")
        elif float(np.abs(acceleration[:, i]).max()) >= _FULL * pace.acceleration_rad_s2:
            words.append(f"{name} at its top acceleration")
    return words


def near_limits(
    joints: Matrix, lower: Vector, upper: Vector, names: Sequence[str], units: Sequence[str]
) -> tuple[NearLimit, ...]:
    """Return the joints that come near a limit, closest first; see ``near_limit``.

    Args:
        joints: Along the way (k, n), rad or m.
        lower: The lower limits (n,); infinite where there is none.
        upper: The upper limits (n,).
        names: Their names.
        units: ``rad`` or ``m`` for each.
    """
    found: list[tuple[float, NearLimit]] = []
    for i, (name, unit) in enumerate(zip(names, units, strict=True)):
        span = float(upper[i] - lower[i])
        if not 0.0 < span < math.inf:  # a joint that turns freely, or cannot turn
            continue
        below, above = (
            float((joints[:, i] - lower[i]).min()),
            float((upper[i] - joints[:, i]).min()),
        )
        room, side = min((below, "lower"), (above, "upper"))
        if room <= near_distance(float(lower[i]), float(upper[i]), unit):
            found.append((room / span, NearLimit(name, side, room, unit)))
    return tuple(near for _, near in sorted(found, key=lambda each: each[0]))

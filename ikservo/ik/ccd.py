"""Cyclic coordinate descent: move one joint after another to its best position.

One joint alone moves the tip along a circle or a straight line, whose point nearest to the target
is known in closed form; a joint moves towards it by at most `MAX_STEP` per sweep. No matrix is
inverted and the error never grows; but joints that must move together alternate, which is slow
along narrow valleys.
"""

from __future__ import annotations

import math

import numpy as np

from ikservo.ik.jacobian_methods import Linearisation, ResidualFunction, backtrack, iterate
from ikservo.ik.problem import Options, Target
from ikservo.ik.result import Result
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Vector

MAX_STEP = math.radians(5.0)
"""Maximum motion of a joint in one sweep, because the last joints would otherwise curl up before
the first have moved; a prismatic joint may move the same number of metres (87 mm)."""

_MAX_ITERATIONS = 1000
# A joint whose lever times distance [m²] is this small has no effect, and must not rotate.
_MIN_LEVER = 1e-15


def ccd(chain: Chain, target: Target, q0: Vector, options: Options) -> Result:
    """Sweep over the joints from the last to the first, repeatedly, from ``q0``."""
    task = ResidualFunction(chain, target)

    def sweep(current: Linearisation) -> Linearisation:
        for joint in reversed(range(chain.dof)):
            step = np.zeros(chain.dof)
            step[joint] = _best_joint_step(chain, current, joint)
            # On a circle or a line this step reduces the error, but not always if other joints
            # mimic this one.
            if step[joint]:
                current = backtrack(task, current, step)
        return current

    return iterate("ccd", sweep, task, q0, options, _MAX_ITERATIONS)


def best_rotation(E: Vector, v: Vector, axis: Vector) -> float:
    """Find the angle [rad] about a joint's axis that brings the tip nearest to the target.

    Rotating by t moves a point of velocity v by ``v sin t + n (1 - cos t)`` with ``n = axis × v``,
    which points to the circle's centre. Seen from there the target is at ``F = E - n``, and the
    remaining error is ``|E(t)|² = |F|² + |n|² + 2 F·n cos t - 2 F·v sin t``.

    Args:
        E: M - f(q) of one point or several, stacked (3 k,) [m].
        v: The velocities (3 k,) of these points [m/rad].
        axis: The unit axis (3,) of their rotation.
    """
    n = np.cross(axis, v.reshape(-1, 3)).ravel()
    F = E - n
    sin, cos = float(F @ v), -float(F @ n)
    return math.atan2(sin, cos) if math.hypot(sin, cos) > _MIN_LEVER else 0.0


def best_translation(E: Vector, v: Vector) -> float:
    """Compute the distance along ``v`` (m,) that brings the tip nearest to the target."""
    size = float(v @ v)
    return float(E @ v) / size if size > _MIN_LEVER else 0.0


def clamp_angle_to_range(angle_rad: float, low_rad: float, high_rad: float) -> float:
    """Clamp an angle, by the shorter way round, to a range of at most one revolution."""
    if low_rad <= angle_rad <= high_rad:
        return angle_rad
    return max(low_rad, high_rad, key=lambda end: math.cos(end - angle_rad))


def _best_joint_step(chain: Chain, current: Linearisation, joint: int) -> float:
    """Compute the step of one joint to its best position, inside its limits and the step limit."""
    q, v, axis = float(current.q[joint]), current.J[:, joint], current.axes[:, joint]
    low = max(float(chain.lower_rad[joint]) - q, -MAX_STEP)
    high = min(float(chain.upper_rad[joint]) - q, MAX_STEP)
    rate = math.sqrt(float(axis @ axis))  # 1, unless a joint that follows carries the tip
    if rate == 0.0:
        return min(max(best_translation(current.E, v), low), high)
    angle = best_rotation(current.E, v / rate, axis / rate)
    return clamp_angle_to_range(angle, low * rate, high * rate) / rate

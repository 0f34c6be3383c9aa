"""Find a nearby collision-free posture for an arm that touches something."""

from __future__ import annotations

import numpy as np

from ikservo.guard.collision import CollisionChecker
from ikservo.kinematics.arrays import Vector

_STEP = 0.03  # per joint in an iteration, rad or m
_DIFFERENCE = 1e-4  # per joint for the derivatives of distances, rad or m
_MAX_STEPS = 60  # iterations: a joint moves by at most 1.8 rad
_NEAR_M = 0.06  # nearer pairs must not come into contact in the next step
_LEAST_GAIN_M = 2e-5  # smaller gains per step do not free the arm
# An arm is free at the first distance. The larger distances, if the arm can reach them, keep its
# next motion from touching the same obstacle again.
_DISTANCES_M = (0.003, 0.02, 0.05)


def nearest_free_posture(
    checker: CollisionChecker, q: Vector, lower: Vector, upper: Vector
) -> Vector | None:
    """Find joints (dof,) near ``q`` (dof,) at which nothing touches, rad or m.

    A joint outside its limits (dof,) may move back inside.

    Returns:
        The posture; None if no small step frees the arm.
    """
    lower, upper = np.minimum(lower, q), np.maximum(upper, q)
    free = None
    for distance_m in _DISTANCES_M:
        further = _move_apart(checker, q if free is None else free, lower, upper, distance_m)
        if further is None:
            break
        free = further
    return free


def _move_apart(
    checker: CollisionChecker, q: Vector, lower: Vector, upper: Vector, distance_m: float
) -> Vector | None:
    """Find joints (dof,) near ``q`` at which all pairs keep a distance; None if not found.

    Each step maximises the gain in distance of all pairs that are too near while no other pair
    comes too near; it is a linear program in the joints (the non-penetration constraints of
    Faverjon and Tournassoud 1987).
    """
    from scipy.optimize import linprog  # noqa: PLC0415

    for _ in range(_MAX_STEPS):
        gap_m = checker.distances_with_sag(q[None])[0]
        if gap_m.min() >= distance_m:
            return q
        near = np.flatnonzero(gap_m < _NEAR_M)
        steps = _DIFFERENCE * np.eye(len(q))
        ahead, behind = np.split(
            checker.distances_with_sag(np.vstack([q + steps, q - steps]))[:, near], 2
        )
        slope = (ahead - behind).T / (2.0 * _DIFFERENCE)
        too_near = gap_m[near] < distance_m
        # Unknowns: the step of each joint, and the common gain of all pairs that are too near.
        bounds = zip(np.maximum(lower - q, -_STEP), np.minimum(upper - q, _STEP), strict=True)
        step = linprog(
            np.append(np.zeros(len(q)), -1.0),
            A_ub=np.column_stack([-slope, too_near]),
            b_ub=np.where(too_near, 0.0, gap_m[near] - distance_m),
            bounds=[*bounds, (0.0, _NEAR_M)],
        ).x
        if step is None or step[-1] < _LEAST_GAIN_M:
            return None
        q = q + step[:-1]
    return None

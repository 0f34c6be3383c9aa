"""Compiled projection for searches: move joints so that the tool keeps its tilt and place limits.

Angles are compared by chords, as in ``forward_kinematics``.
"""

from __future__ import annotations

import math

from ikservo.kernels.compiled import entry
from ikservo.kernels.forward_kinematics import forward_kinematics
from ikservo.kernels.layout import END_POINTS, FREE, J_WEIGHTED, RESIDUAL, STEP, TOOL_POSE, J, Q
from ikservo.kernels.linear_algebra import least_norm
from ikservo.kernels.search import is_packed_chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.packed import DOF, LOWER, STEPS, UPPER

# A limit: 1 for an angle and 0 for a plane; the largest chord or distance; an axis of the tool or
# the outward normal (3,); the direction near which the axis stays, or a point of the plane (3,).
_IS_ANGLE, _MOST, _OWN, _WORLD, _WIDTH = 0, 1, 2, 5, 8

_STEPS, _LONGEST, _DAMPING, _ROWS = 25, 0.3, 1e-6, 6
# Limits are kept with this margin [m, or chord]; the point is met within this tolerance [m].
_BEYOND, _MET_M = 1e-4, 5e-6
_TINY = 1e-9


def poses_fit(arm: Matrix, work: Matrix, joints: Matrix, poses: Matrix) -> bool:
    """Check whether arrays have the shapes that ``tool_poses`` needs."""
    if not is_packed_chain(arm):
        return False
    n = int(arm[0, DOF])
    return (
        joints.shape[1] == n
        and len(poses) == len(joints)
        and poses.shape[1] == 12
        and len(work) >= END_POINTS + n
        and work.shape[1] >= max(n + 2, 12)
    )


@entry(poses_fit)
def tool_poses(arm: Matrix, work: Matrix, joints: Matrix, poses: Matrix) -> None:
    """Fill poses (k, 12), R row by row and then p, of the tool at joints (k, n)."""
    for k in range(len(joints)):
        for j in range(joints.shape[1]):
            work[Q, j] = joints[k, j]
        forward_kinematics(arm, work)
        for i in range(12):
            poses[k, i] = work[TOOL_POSE, i]


def limits_fit(
    arm: Matrix, limits: Matrix, work: Matrix, target: Vector, aims: bool, joints: Vector
) -> bool:
    """Check whether arrays have the shapes that ``project_tool`` needs."""
    if not is_packed_chain(arm):
        return False
    n = int(arm[0, DOF])
    return (
        limits.shape[1] == _WIDTH
        and len(target) == 3
        and len(joints) == n
        and len(work) >= END_POINTS + n
        and work.shape[1] >= max(n + 2, 12)
    )


@entry(limits_fit)
def project_tool(
    arm: Matrix, limits: Matrix, work: Matrix, target: Vector, aims: bool, joints: Vector
) -> bool:
    """Move joints (n,) to the nearest joints that keep the limits, or to nearly the nearest.

    Args:
        arm: The packed chain.
        limits: (m, 8) one row per limit.
        work: The work array.
        target: A point (3,) for the tip.
        aims: Whether the tip must be at the target.
        joints: The joints (n,) at the start, replaced by the joints that were found.

    Returns:
        Whether the found positions keep the limits.
    """
    n = int(arm[0, DOF])
    for j in range(n):
        work[Q, j], work[FREE, j] = joints[j], 1.0
    for _ in range(_STEPS):
        forward_kinematics(arm, work)
        found, rows = _point_rows(target, aims, n, work), 3 if aims else 0
        for i in range(len(limits)):
            if rows == _ROWS:
                break
            beyond = _beyond(limits, i, n, work, rows)
            if beyond > 0.0:
                found = False
                work[RESIDUAL, rows] = -beyond - _BEYOND
                rows += 1
        if found:
            for j in range(n):
                joints[j] = work[Q, j]
            return True
        for j in range(n):
            work[STEP, j] = 0.0
        least_norm(max(rows, 3), _DAMPING, n, work)
        _take_step(arm, n, work)
    return False


def keeps_limits(arm: Matrix, limits: Matrix, work: Matrix, joints: Vector) -> bool:
    """Check whether the tool keeps limits (m, 8) at joints (n,)."""
    n = int(arm[0, DOF])
    for j in range(n):
        work[Q, j] = joints[j]
    forward_kinematics(arm, work)
    for i in range(len(limits)):
        beyond = _beyond(limits, i, n, work, 0)
        if beyond > _TINY:
            return False
    return True


def _point_rows(target: Vector, aims: bool, n: int, work: Matrix) -> bool:
    """Fill the rows of the point, with zeros if there is no point; return whether it is met."""
    met = True
    for r in range(3):
        error = target[r] - work[TOOL_POSE, 9 + r]
        work[RESIDUAL, r] = error if aims else 0.0
        met = met and (not aims or abs(error) <= _MET_M)
        for j in range(n):
            work[J_WEIGHTED + r, j] = work[J + r, j] if aims else 0.0
    return met


def _take_step(arm: Matrix, n: int, work: Matrix) -> None:
    """Take the step, shortened, inside the limits of the joints."""
    longest, steps = _TINY, int(arm[0, STEPS])
    for j in range(n):
        longest = max(longest, abs(work[STEP, j]))
    for j in range(n):
        moved = work[Q, j] + min(1.0, _LONGEST / longest) * work[STEP, j]
        limit = 2 + steps + j
        work[Q, j] = min(max(moved, arm[limit, LOWER]), arm[limit, UPPER])


def _beyond(limits: Matrix, i: int, n: int, work: Matrix, row: int) -> float:
    """Return the excess over a limit; if it is exceeded, fill a row with the excess's gradient."""
    a0, a1, a2 = limits[i, _OWN], limits[i, _OWN + 1], limits[i, _OWN + 2]
    w0, w1, w2 = limits[i, _WORLD], limits[i, _WORLD + 1], limits[i, _WORLD + 2]
    if limits[i, _IS_ANGLE] == 0.0:
        beyond = a0 * (work[TOOL_POSE, 9] - w0) - limits[i, _MOST]
        beyond += a1 * (work[TOOL_POSE, 10] - w1) + a2 * (work[TOOL_POSE, 11] - w2)
        if beyond > 0.0:
            for j in range(n):
                g = a0 * work[J, j] + a1 * work[J + 1, j] + a2 * work[J + 2, j]
                work[J_WEIGHTED + row, j] = g
        return beyond
    v0 = work[TOOL_POSE, 0] * a0 + work[TOOL_POSE, 1] * a1 + work[TOOL_POSE, 2] * a2
    v1 = work[TOOL_POSE, 3] * a0 + work[TOOL_POSE, 4] * a1 + work[TOOL_POSE, 5] * a2
    v2 = work[TOOL_POSE, 6] * a0 + work[TOOL_POSE, 7] * a1 + work[TOOL_POSE, 8] * a2
    chord = math.sqrt((v0 - w0) * (v0 - w0) + (v1 - w1) * (v1 - w1) + (v2 - w2) * (v2 - w2))
    if chord > limits[i, _MOST]:
        c0, c1, c2 = v1 * w2 - v2 * w1, v2 * w0 - v0 * w2, v0 * w1 - v1 * w0
        for j in range(n):
            g = c0 * work[J + 3, j] + c1 * work[J + 4, j] + c2 * work[J + 5, j]
            work[J_WEIGHTED + row, j] = -g / chord
    return chord - limits[i, _MOST]

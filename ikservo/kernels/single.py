"""One target at a time, from pose to joint positions: the kernel that ``Solver`` calls."""

from __future__ import annotations

import numpy as np

from ikservo.kernels.compiled import entry
from ikservo.kernels.layout import (
    DIRECTION,
    IDLE_COLUMN,
    IDLE_LOWER,
    IDLE_OUTSIDE,
    IDLE_UPPER,
    IDLE_WIDTH,
    INVALID,
    IS_REACHED,
    KIND,
    MAX_POSITION_M,
    NOT_HOMOGENEOUS,
    POSE,
    POSITION_ONLY,
    REACHED,
    WANTED_POSITION,
    WANTED_ROTATION,
)
from ikservo.kernels.search import all_within, fits, is_rotation, solve_rows
from ikservo.kinematics.arrays import Matrix, Vector

NAME = "solve_pose"
"""Name for ``bind``."""


def target_fits(packed: Matrix, with_rotation: bool) -> bool:
    """Check whether a packed target has the shape that ``is_target`` needs."""
    return len(packed) == 4 and packed.shape[1] == 3


@entry(target_fits)
def is_target(packed: Matrix, with_rotation: bool) -> bool:
    """Check whether a target's numbers are finite and not too large, and its rotation is valid.

    Args:
        packed: The target position, then the rotation row by row (4, 3).
        with_rotation: Whether the rotation counts.
    """
    problem = np.empty(12)
    for r in range(4):
        for c in range(3):
            problem[3 * r + c] = packed[r, c]
    kind = POSE if with_rotation else POSITION_ONLY
    return all_within(problem, MAX_POSITION_M) and is_rotation(problem, kind)


def pose_fits(
    arm: Matrix,
    problems: Matrix,
    settings: Vector,
    starts: Matrix,
    seeds: Matrix,
    work: Matrix,
    scores: Matrix,
    trace: Matrix,
    results: Matrix,
    axis: Vector,
    idle: Matrix,
    T: Matrix,
    q0: Vector,
) -> bool:
    """Check whether arrays have the shapes that ``solve_pose`` needs, and indices are in range."""
    if not fits(arm, problems, settings, starts, seeds, work, scores, trace, results):
        return False
    n = starts.shape[1]
    for i in range(len(idle)):
        column = idle[i, IDLE_COLUMN]
        if not 0.0 <= column < n:
            return False
    return (
        len(problems) == 1
        and len(axis) == 3
        and idle.shape[1] == IDLE_WIDTH
        and len(T) == 4
        and T.shape[1] == 4
        and len(q0) == n
    )


@entry(pose_fits)
def solve_pose(
    arm: Matrix,
    problems: Matrix,
    settings: Vector,
    starts: Matrix,
    seeds: Matrix,
    work: Matrix,
    scores: Matrix,
    trace: Matrix,
    results: Matrix,
    axis: Vector,
    idle: Matrix,
    T: Matrix,
    q0: Vector,
) -> int:
    """Solve for one pose; the first nine arrays are those of ``solve_all`` with one row each.

    Args:
        arm: See ``solve_all``, like the following up to ``results``.
        problems: (1, PROBLEM_SIZE), filled.
        settings: See ``solve_all``.
        starts: (1, dof), filled.
        seeds: See ``solve_all``.
        work: See ``solve_all``.
        scores: See ``solve_all``.
        trace: See ``solve_all``.
        results: (1, 2 dof + RESULT_TAIL), filled.
        axis: The tool axis (3,) with which a direction is compared, in the tool's frame.
        idle: Joints that do not move the tool (k, IDLE_WIDTH): column, lower and upper limit. They
            stay at the start if it is inside the limits; otherwise the caller must move them.
        T: The target pose T_world_tool (4, 4).
        q0: The start (dof,).

    Returns:
        IS_REACHED or 0, plus IDLE_OUTSIDE if an idle joint starts outside its limits; INVALID or
        NOT_HOMOGENEOUS if the pose or the start is not valid.
    """
    if T[3, 0] != 0.0 or T[3, 1] != 0.0 or T[3, 2] != 0.0 or T[3, 3] != 1.0:
        return NOT_HOMOGENEOUS
    kind, n = int(settings[KIND]), starts.shape[1]
    for r in range(3):
        problems[0, WANTED_POSITION + r] = T[r, 3]
        if kind == POSE:
            for c in range(3):
                problems[0, WANTED_ROTATION + 3 * r + c] = T[r, c]
        elif kind == DIRECTION:
            problems[0, WANTED_ROTATION + 3 * r + 2] = (
                T[r, 0] * axis[0] + T[r, 1] * axis[1] + T[r, 2] * axis[2]
            )
    for j in range(n):
        starts[0, j] = q0[j]
    invalid_row = solve_rows(arm, problems, settings, starts, seeds, work, scores, trace, results)
    if invalid_row >= 0:
        return INVALID
    status = IS_REACHED if results[0, 2 * n + REACHED] == 1.0 else 0
    outside = 0
    for i in range(len(idle)):
        column = int(idle[i, IDLE_COLUMN])
        start = starts[0, column]
        if start >= idle[i, IDLE_LOWER] and start <= idle[i, IDLE_UPPER]:
            results[0, column] = start
        else:
            outside = IDLE_OUTSIDE
    return status + outside

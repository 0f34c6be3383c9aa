"""Sampling of paths for checks, with closer samples where a limit may be exceeded."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ikservo.kinematics.arrays import Matrix, Vector

MAX_SAMPLE_STEP_RAD = 0.05
"""Largest motion of a joint between two samples of a path that is checked for collisions [rad]."""

_MAX_HALVINGS = 12  # largest number of times that the interval between two samples is halved


def sample_path(
    positions_at: Callable[[float], Vector], duration_s: float, top_speed_rad_s: float
) -> Matrix:
    """Sample joints (k, n) of a trajectory with its ends, densely enough for collision checks."""
    times_s = np.linspace(0.0, duration_s, _sample_count(duration_s * top_speed_rad_s))
    return np.array([positions_at(time_s) for time_s in times_s])


def sample_line(start: Vector, goal: Vector, unit_per_rad: Vector | float = 1.0) -> Matrix:
    """Sample joints (k, n) on the straight line from a start to a goal, including both.

    ``unit_per_rad`` is the joint motion per radian of its servo's horn: 1 rad, or metres.
    """
    distance_rad = float(np.abs((goal - start) / unit_per_rad).max())
    return np.linspace(start, goal, _sample_count(distance_rad))


def thin_path(joints: Matrix) -> Matrix:
    """Return the rows of a densely sampled path (k, n) that collision checks need.

    The first and the last row are included. The distance between two rows exceeds the sampling step
    by at most the distance between two given rows.
    """
    travelled = np.abs(np.diff(joints, axis=0)).max(axis=1)
    travelled_rad = np.concatenate([[0.0], np.cumsum(travelled)])
    marks_rad = np.arange(0.0, travelled_rad[-1], MAX_SAMPLE_STEP_RAD)
    return joints[np.unique(np.append(np.searchsorted(travelled_rad, marks_rad), len(joints) - 1))]


def refine_path(
    path: Matrix,
    measure: Callable[[Matrix], Matrix],
    unresolved_after: Callable[[Matrix, Matrix], NDArray[np.intp]],
) -> tuple[Vector, Matrix]:
    """Refine the samples of a path if a measured value may exceed its limit between them.

    Args:
        path: Joints (k, n), interpolated linearly.
        measure: Returns values (k, m) at joints (k, n).
        unresolved_after: Returns, from the values, the indices (i,) of samples before such
            intervals.

    Returns:
        The sampled fractions of the path (j,), and the values at these (j, m).
    """
    fractions, values = np.linspace(0.0, 1.0, len(path)), measure(path)
    for _ in range(_MAX_HALVINGS):
        unresolved = unresolved_after(path, values)
        if not len(unresolved):
            break
        between = 0.5 * (path[unresolved] + path[unresolved + 1])
        middle = 0.5 * (fractions[unresolved] + fractions[unresolved + 1])
        path = np.insert(path, unresolved + 1, between, axis=0)
        fractions = np.insert(fractions, unresolved + 1, middle)
        values = np.insert(values, unresolved + 1, measure(between), axis=0)
    return fractions, values


def _sample_count(distance_rad: float) -> int:
    return max(2, 1 + math.ceil(distance_rad / MAX_SAMPLE_STEP_RAD))

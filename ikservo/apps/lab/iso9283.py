"""Performance criteria of ISO 9283:1998: accuracy and repeatability of poses and paths, drift.

Only positions are evaluated: attained points (n, 3) of n cycles in any unit of length; results have
the same unit.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError
from ikservo.kinematics.arrays import Matrix, Vector


def pose_accuracy(attained: ArrayLike, commanded: ArrayLike) -> float:
    """Compute the positioning accuracy AP_P according to ISO 9283.

    ``AP_P = √((x̄ - x_c)² + (ȳ - y_c)² + (z̄ - z_c)²)``, with x̄, ȳ, z̄ the barycentre of the cluster.

    Args:
        attained: The points (n, 3), n at least 1.
        commanded: The commanded point (3,).

    Raises:
        BadValueError: There is no point, or the shape is wrong.
    """
    points = _checked(attained, "points", 1)
    return float(np.linalg.norm(points.mean(axis=0) - np.asarray(commanded, dtype=np.float64)))


def pose_repeatability(attained: ArrayLike) -> float:
    """Return the positioning repeatability RP_l according to ISO 9283.

    ``RP_l = l̄ + 3 S_l`` with ``l_j`` the distance of point j from the barycentre, l̄ its mean and
    ``S_l = √(Σ (l_j - l̄)² / (n - 1))``.

    Args:
        attained: The points (n, 3), n at least 2.

    Raises:
        BadValueError: There are fewer points, or the shape is wrong.
    """
    points = _checked(attained, "points", 2)
    return float(_sphere_radii(points[:, None, :])[0])


def multidirectional_variation(clusters: Sequence[ArrayLike]) -> float:
    """Compute the multi-directional pose accuracy variation vAP_P according to ISO 9283.

    ``vAP_P = max √((x̄_h - x̄_k)² + (ȳ_h - ȳ_k)² + (z̄_h - z̄_k)²)`` over the directions h and k.

    Args:
        clusters: The points (n, 3) attained from each of two or more directions.

    Raises:
        BadValueError: There is only one direction, or a direction has no points.
    """
    centres = [_checked(points, "points", 1).mean(axis=0) for points in clusters]
    if len(centres) < 2:
        raise BadValueError("The number of directions", len(centres), "two or more")
    return max(float(np.linalg.norm(a - b)) for a, b in combinations(centres, 2))


def path_accuracy(attained: ArrayLike, commanded: ArrayLike) -> float:
    """Compute the positioning path accuracy AT_P according to ISO 9283.

    ``AT_P = max_i √((x̄_i - x_ci)² + (ȳ_i - y_ci)² + (z̄_i - z_ci)²)`` over m points of the path,
    with x̄_i, ȳ_i, z̄_i the barycentre of the points in which n attained paths cross the plane normal
    to the commanded path at point i.

    Args:
        attained: The crossings (n, m, 3) of n cycles.
        commanded: The points (m, 3) of the commanded path.

    Raises:
        BadValueError: There is no cycle, or a shape is wrong.
    """
    paths = _checked(attained, "paths", 1)
    off = paths.mean(axis=0) - np.asarray(commanded, dtype=np.float64)
    return float(np.linalg.norm(off, axis=1).max())


def path_repeatability(attained: ArrayLike) -> float:
    """Return the positioning path repeatability RT_P according to ISO 9283.

    ``RT_P = max_i (l̄_i + 3 S_li)``, computed in each plane normal to the path as in
    ``pose_repeatability``.

    Args:
        attained: The crossings (n, m, 3) of n cycles, n at least 2.

    Raises:
        BadValueError: There are fewer cycles, or the shape is wrong.
    """
    return float(_sphere_radii(_checked(attained, "paths", 2)).max())


def largest_drift(values: Sequence[float]) -> float:
    """Compute the drift of accuracy dAP_P, or of repeatability dRP_P, according to ISO 9283.

    ``dAP_P = max |AP_P(t=0) - AP_P(t)|``; dRP_P is computed in the same way.

    Args:
        values: AP_P or RP_l of one pose at successive times, at least one.
    """
    return max(abs(value - values[0]) for value in values)


def path_crossings(measured: ArrayLike, points: ArrayLike, tangents: ArrayLike) -> Matrix:
    """Compute the crossings of a measured path with the planes normal to a commanded path.

    If it crosses a plane several times, as a circle does, the crossing nearest to the commanded
    point counts.

    Args:
        measured: The points (k, 3) of one cycle, in chronological order.
        points: The points (m, 3) of the commanded path.
        tangents: The unit tangents (m, 3) of the path at these points.

    Returns:
        The crossings (m, 3), between measured points by linear interpolation.

    Raises:
        BadValueError: A plane is not crossed.
    """
    path = _checked(measured, "points", 2)
    found: list[Vector] = []
    for point, tangent in zip(np.asarray(points), np.asarray(tangents), strict=True):
        side = (path - point) @ tangent
        before = np.flatnonzero((side[:-1] <= 0.0) & (side[1:] > 0.0))
        if not len(before):
            what, expected = "The measured path", "a path that crosses each plane"
            raise BadValueError(what, "not long enough", expected)
        fraction = side[before] / (side[before] - side[before + 1])
        crossings = path[before] + fraction[:, None] * (path[before + 1] - path[before])
        found.append(crossings[int(np.linalg.norm(crossings - point, axis=1).argmin())])
    return np.array(found)


def _sphere_radii(clusters: Matrix) -> Vector:
    """Return l̄ + 3 S_l (m,) of m clusters (n, m, 3)."""
    distances: Vector = np.linalg.norm(clusters - clusters.mean(axis=0), axis=2)
    return distances.mean(axis=0) + 3.0 * distances.std(axis=0, ddof=1)


def _checked(attained: ArrayLike, what: Literal["points", "paths"], least: int) -> Matrix:
    dimensions, shape = (2, "(n, 3)") if what == "points" else (3, "(n, m, 3)")
    array = np.asarray(attained, dtype=np.float64)
    if array.ndim != dimensions or array.shape[-1] != 3 or len(array) < least:
        found, expected = f"of shape {array.shape}", f"{what} {shape}, n at least {least}"
        raise BadValueError(f"The array of attained {what}", found, expected)
    return array

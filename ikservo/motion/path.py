"""Paths in space: splines, blended corners, orientation interpolation, the plane of an arm."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Protocol

import numpy as np

from ikservo.errors import BadValueError
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import exp_so3, log_so3


class Path(Protocol):
    """A smooth curve of n values as a function of distance, in metres, radians or another unit."""

    @property
    def length(self) -> float:
        """The distance at the end of the path; at its start, the distance is 0."""
        ...

    def at(self, distance: float) -> tuple[Vector, Vector, Vector]:
        """Compute the point and its first two derivatives (n,) at a distance."""
        ...

    def max_derivatives(self, begin: float, end: float) -> tuple[Vector, Vector, Vector]:
        """Compute the largest magnitudes of the first three derivatives (n,) in an interval."""
        ...


class ToolPath(Protocol):
    """A path of the tip (3,) in metres, which the joints have to follow.

    Attributes:
        shape: The name of the path in messages.
    """

    shape: str

    @property
    def length(self) -> float:
        """The distance at the end of the path; at its start, the distance is 0."""
        ...

    @property
    def breakpoints(self) -> list[float]:
        """The distances at which the type of the curve changes, and both ends."""
        ...

    def path_length(self) -> float:
        """Return the length of the curve itself, which is shorter with rounded corners."""
        ...

    def at(self, distance: float) -> tuple[Vector, Vector, Vector]:
        """Compute the point and its first two derivatives (3,) at a distance."""
        ...


# Points nearer than this are equal.
_SAME_POINT_M = 1e-9


class BlendedPath:
    """Straight lines through points in n dimensions, with a blend instead of each corner.

    In a blend, the tangent changes from the direction of one line to the direction of the other
    with the polynomial 3x² - 2x³, so two derivatives are continuous. The curve then passes
    each corner within 3/8 of the blend, stays inside the box of its points, and is never longer
    than the lines.

    Args:
        points: The points (k, n).
        blends: The distance before each of the k - 2 inner points at which the curve leaves the
            line; at most half of a line is used.
        order: The norm that measures distances: 2 for metres in space, inf for joints.

    Raises:
        BadValueError: A blend is not positive.

    Attributes:
        shape: The name of the path in messages.
    """

    shape = "line"

    def __init__(self, points: Matrix, blends: Sequence[float], order: float = 2) -> None:
        if not all(0.0 < blend < np.inf for blend in blends):
            raise BadValueError("The blend", list(blends), "a positive distance")
        kept, kept_blends = [points[0]], list[float]()
        for point, blend in zip(points[1:], [*blends, 0.0], strict=True):
            if float(np.linalg.norm(point - kept[-1], order)) > _SAME_POINT_M:
                kept.append(point)
                kept_blends.append(blend)
        self._pieces = list(_make_segments(np.array(kept), kept_blends[:-1], order))
        self._begins = [piece.begin for piece in self._pieces]
        self.length = self._pieces[-1].end if self._pieces else 0.0
        self._start = points[0]

    @property
    def breakpoints(self) -> list[float]:
        """The distances at which blends begin and end, and both ends of the path."""
        return [*self._begins, self.length]

    def path_length(self) -> float:
        """Compute the length of the curve itself, which is shorter with blended corners."""
        distances = np.linspace(0.0, self.length, 2 + 64 * len(self._pieces))
        points = np.array([self.at(distance)[0] for distance in distances.tolist()])
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())

    def at(self, distance: float) -> tuple[Vector, Vector, Vector]:
        """Compute the point and its first two derivatives (n,) at a distance."""
        if not self._pieces:
            return self._start, np.zeros_like(self._start), np.zeros_like(self._start)
        inside = min(max(distance, 0.0), self.length)
        return self._pieces[max(bisect_right(self._begins, inside) - 1, 0)].at(inside)

    def max_derivatives(self, begin: float, end: float) -> tuple[Vector, Vector, Vector]:
        """Compute the largest magnitudes of the first three derivatives (n,) in an interval."""
        inside = [p.max_derivatives() for p in self._pieces if p.begin < end and p.end > begin]
        slopes, bends, twists = zip(*inside, strict=True)
        return np.max(slopes, axis=0), np.max(bends, axis=0), np.max(twists, axis=0)


@dataclass(frozen=True, slots=True, eq=False)
class _BlendSegment:
    """A line, or a blend of two lines, in which the tangent changes between directions (n,)."""

    begin: float
    end: float
    point: Vector
    slope: Vector
    next_slope: Vector

    def at(self, distance: float) -> tuple[Vector, Vector, Vector]:
        width, change = self.end - self.begin, self.next_slope - self.slope
        x = (distance - self.begin) / width
        return (
            self.point + width * (x * self.slope + x**3 * (1.0 - 0.5 * x) * change),
            self.slope + x * x * (3.0 - 2.0 * x) * change,
            6.0 * x * (1.0 - x) / width * change,
        )

    def max_derivatives(self) -> tuple[Vector, Vector, Vector]:
        width, change = self.end - self.begin, np.abs(self.next_slope - self.slope)
        slope = np.maximum(np.abs(self.slope), np.abs(self.next_slope))
        return slope, 1.5 / width * change, 6.0 / width**2 * change


def _make_segments(points: Matrix, blends: Sequence[float], order: float) -> list[_BlendSegment]:
    legs = [b - a for a, b in pairwise(points)]
    lengths = [float(np.linalg.norm(leg, order)) for leg in legs]
    slopes = [leg / length for leg, length in zip(legs, lengths, strict=True)]
    cuts = [min(r, 0.5 * a, 0.5 * b) for r, (a, b) in zip(blends, pairwise(lengths), strict=True)]
    pieces: list[_BlendSegment] = []
    travelled = 0.0
    for i, (slope, length) in enumerate(zip(slopes, lengths, strict=True)):
        before, after = (0.0, *cuts)[i], (*cuts, 0.0)[i]
        straight = length - before - after
        if straight > _SAME_POINT_M:
            pieces.append(
                _BlendSegment(
                    travelled, travelled + straight, points[i] + before * slope, slope, slope
                )
            )
            travelled += straight
        if after > 0.0:
            entry = points[i + 1] - after * slope
            pieces.append(
                _BlendSegment(travelled, travelled + 2.0 * after, entry, slope, slopes[i + 1])
            )
            travelled += 2.0 * after
    return pieces


_NEGLIGIBLE = 1e-300


class SplinePath:
    """The cubic spline through points at given distances (scipy's, not-a-knot ends).

    Args:
        distances: The distances of the points (k,), increasing from 0; at least four.
        points: The points (k, n).

    Attributes:
        length: The distance of the last point.
    """

    def __init__(self, distances: Vector, points: Matrix) -> None:
        from scipy.interpolate import CubicSpline  # noqa: PLC0415  # half a second to import

        self.length = float(distances[-1])
        self.distances = distances
        self._curve = CubicSpline(distances, points)
        # Each piece is c₀t³ + c₁t² + c₂t + c₃; its slope is largest at an end or at the vertex.
        c, width = np.asarray(self._curve.c, dtype=np.float64), np.diff(distances)[:, None]
        summit = np.clip(-c[1] / (3.0 * np.where(c[0] == 0.0, _NEGLIGIBLE, c[0])), 0.0, width)
        slopes = [np.abs((3.0 * c[0] * t + 2.0 * c[1]) * t + c[2]) for t in (0.0, summit, width)]
        bends = [np.abs(6.0 * c[0] * t + 2.0 * c[1]) for t in (0.0, width)]
        self._slopes: Matrix = np.max(slopes, axis=0)
        self._bends: Matrix = np.max(bends, axis=0)
        self._twists: Matrix = np.abs(6.0 * c[0])

    def at(self, distance: float) -> tuple[Vector, Vector, Vector]:
        """Compute the point and its first two derivatives (n,) at a distance."""
        inside = min(max(distance, 0.0), self.length)
        q, slope, bend = (np.asarray(self._curve(inside, order)) for order in (0, 1, 2))
        return q, slope, bend

    def points(self, distances: Vector) -> Matrix:
        """Compute the points (k, n) at distances (k,)."""
        return np.asarray(self._curve(distances), dtype=np.float64)

    def max_derivatives(self, begin: float, end: float) -> tuple[Vector, Vector, Vector]:
        """Compute the largest magnitudes of the first three derivatives (n,) in an interval."""
        first = max(int(np.searchsorted(self.distances, begin, side="right")) - 1, 0)
        last = max(int(np.searchsorted(self.distances, end, side="left")), first + 1)
        pieces = slice(first, last)
        return (
            self._slopes[pieces].max(axis=0),
            self._bends[pieces].max(axis=0),
            self._twists[pieces].max(axis=0),
        )


_FREE_WRIST_DOF = 6
_PARALLEL = 0.99


class ArmPlane:
    """The vertical plane of an arm, rotated about the vertical by its first joint.

    The first joint of an arm with four or five joints also rotates its tool's heading; pitch and
    roll remain free in the plane. Arms with six joints or more, or without an upright first axis,
    have no plane: they keep an orientation in the world.

    Args:
        chain: The arm.
        in_world: Whether orientations are in the world frame for every arm.
    """

    def __init__(self, chain: Chain, *, in_world: bool = False) -> None:
        axes = chain.jacobian(chain.mid_range())[3:, :2].T
        upright = abs(float(axes[0, 2])) > _PARALLEL
        moves_in_plane = chain.dof > 1 and abs(float(axes[0] @ axes[-1])) < 1.0 - _PARALLEL
        self.rotates = not in_world and chain.dof < _FREE_WRIST_DOF and upright and moves_in_plane
        self._axis: Vector = np.sign(axes[0, 2]) * np.array([0.0, 0.0, 1.0])

    def angle_rad(self, q: Vector) -> float:
        """Compute the rotation of the plane at joints (dof,); 0 for arms without a plane."""
        return float(self._axis[2] * q[0]) if self.rotates else 0.0

    def rotation(self, q: Vector) -> Matrix:
        """Compute the rotation R_world_plane (3, 3) at joints (dof,)."""
        return exp_so3(np.array([0.0, 0.0, self.angle_rad(q)]))


@dataclass(frozen=True, slots=True, eq=False)
class OrientationInterpolation:
    """Interpolation of two orientations: uniform rotation about an axis fixed to the arm plane.

    Attributes:
        plane: The plane to which the orientation is relative.
        start: The orientation R_plane_tool (3, 3) at the start.
        rotation_rad: The rotation vector (3,) of the whole rotation, in the frame of the plane.
    """

    plane: ArmPlane
    start: Matrix
    rotation_rad: Vector

    @classmethod
    def between(
        cls, plane: ArmPlane, start: tuple[Matrix, Vector], end: tuple[Matrix, Vector]
    ) -> OrientationInterpolation:
        """Compute the shortest rotation between orientations R_world_tool at joints (dof,)."""
        first = plane.rotation(start[1]).T @ start[0]
        last = plane.rotation(end[1]).T @ end[0]
        return cls(plane, first, log_so3(last @ first.T))

    @classmethod
    def constant(cls, plane: ArmPlane, R_world_tool: Matrix, q: Vector) -> OrientationInterpolation:
        """Return an interpolation that keeps the tool as it is in the arm's plane at ``q``."""
        return cls.between(plane, (R_world_tool, q), (R_world_tool, q))

    def at(self, fraction: float, q: Vector) -> Matrix:
        """Compute the desired R_world_tool (3, 3) at a fraction of the path, at joints (dof,)."""
        return self.plane.rotation(q) @ exp_so3(fraction * self.rotation_rad) @ self.start

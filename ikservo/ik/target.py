"""What the solver is asked for: a point, and perhaps how the tool stands there."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError
from ikservo.ik.kernel.layout import FURTHEST_M
from ikservo.kinematics import finite_array, finite_vector
from ikservo.kinematics.se3 import Matrix, Vector, log_so3

__all__ = ["Target", "near", "unit"]

_ROTATION_TOLERANCE = 1e-6


@dataclass(frozen=True, eq=False)
class Target:
    """A position for a point of the arm, with a direction or an orientation if wanted.

    Attributes:
        position_m: Where the point shall be (3,), metres, arm's base frame.
        direction: Where the tool axis shall point (3,), base frame; any length but zero.
        orientation: The whole orientation R_world_tool (3, 3); not together with direction.
        frame: The link the point belongs to; the tip if None.
        offset_m: The point in that link's coordinates (3,), metres; its origin if None.
        tool_axis: The axis (3,) in the link's coordinates that ``direction`` speaks of.

    Raises:
        BadValueError: A number is not finite, a shape is wrong, an axis has no length, the
            orientation is no rotation, or both direction and orientation are given.
    """

    position_m: ArrayLike
    direction: ArrayLike | None = None
    orientation: ArrayLike | None = None
    frame: str | None = None
    offset_m: ArrayLike | None = None
    tool_axis: ArrayLike = (0.0, 0.0, 1.0)

    def __post_init__(self) -> None:
        if self.direction is not None and self.orientation is not None:
            raise BadValueError("The target", "over-determined", "a direction or an orientation")
        _ = self.position, self.wanted_axis, self.rotation, self.axis
        _check_frame(self.frame)
        if self.offset_m is not None:
            near(self.offset_m, "offset_m")

    @cached_property
    def position(self) -> Vector:
        """Return the wanted position (3,) [m]."""
        return near(self.position_m, "The target position")

    @cached_property
    def wanted_axis(self) -> Vector | None:
        """Return the wanted direction of the tool axis as a unit vector (3,), or None."""
        return None if self.direction is None else unit(self.direction, "The wanted direction")

    @cached_property
    def axis(self) -> Vector:
        """Return the tool axis as a unit vector (3,) in the frame's coordinates."""
        return unit(self.tool_axis, "The tool axis")

    @cached_property
    def rotation(self) -> Matrix | None:
        """Return the wanted orientation (3, 3), or None."""
        return None if self.orientation is None else _rotation(self.orientation)

    @property
    def only_position(self) -> bool:
        """Return True when any orientation of the tool will do."""
        return self.direction is None and self.orientation is None

    def turn_left(self, R_world_tool: Matrix) -> Vector:
        """Return the rotation vector (3,) [rad] from the tool's pose to the wanted one."""
        if self.rotation is not None:
            return log_so3(self.rotation @ R_world_tool.T)
        if self.wanted_axis is not None:
            return _turn_between(R_world_tool @ self.axis, self.wanted_axis)
        return np.zeros(3)


def _turn_between(a: Vector, b: Vector) -> Vector:
    """Return the shortest rotation vector (3,) that takes unit vector a to unit vector b."""
    normal = np.cross(a, b)
    sin, cos = math.sqrt(float(normal @ normal)), float(a @ b)
    if sin < 1e-12:
        # Parallel: nothing to do. Opposite: any axis across a is as short as another.
        return np.zeros(3) if cos > 0 else math.pi * _across(a)
    turn: Vector = normal * (math.atan2(sin, cos) / sin)
    return turn


def _across(a: Vector) -> Vector:
    helper = np.zeros(3)
    helper[int(np.argmin(np.abs(a)))] = 1.0
    return unit(np.cross(a, helper), "axis")


def _check_frame(frame: object) -> None:
    if frame is not None and not isinstance(frame, str):
        raise BadValueError("The frame", repr(frame), "the name of a link, or None for the tip")


def near(v: ArrayLike, what: str) -> Vector:
    """Return a point (3,) [m] of one's own; BadValueError where it is none or beyond 1 km."""
    point = finite_vector(v, 3, what)
    if float(np.abs(point).max()) > FURTHEST_M:
        raise BadValueError(what, point.tolist(), "metres, within 1 km")
    return point.copy()  # what the caller does with theirs later is no part of the question


def unit(v: ArrayLike, what: str) -> Vector:
    """Return a direction (3,) with length one; BadValueError where it has none."""
    vector = finite_vector(v, 3, what)
    length = math.hypot(*vector.tolist())
    if length < 1e-12:
        raise BadValueError(what, "zero", "a direction")
    if math.isinf(length):
        raise BadValueError(what, vector.tolist(), "a direction of a length that is a number")
    return vector / length


def _rotation(R: ArrayLike) -> Matrix:
    matrix = finite_array(R, (3, 3), "The orientation")
    largest = float(np.abs(matrix).max())
    off = largest if largest > 2.0 else float(np.abs(matrix @ matrix.T - np.eye(3)).max())
    if off > _ROTATION_TOLERANCE or float(np.linalg.det(matrix)) < 0.0:
        raise BadValueError("The orientation", "no rotation matrix", "R Rᵀ = 1 and det R = 1")
    return matrix.copy()

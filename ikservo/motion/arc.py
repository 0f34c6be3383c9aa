"""Circular arcs in space: through a point to an end, or about an axis."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError, format_point
from ikservo.kinematics import finite_vector
from ikservo.kinematics.arrays import Vector

_MIN_RADIUS_M = 1e-4  # with a smaller radius, the tip counts as on the axis
_SAME_POINT_M = 1e-4  # nearer points count as the same
# Three points count as lying on one line if none is further from the line through the others than
# this: half of a servo's tick at 0.3 m, the uncertainty of the start.
_MIN_HEIGHT_M = 2e-4
_MAX_ANGLE_RAD = 20.0 * math.pi  # ten turns


class ArcPath:
    """An arc of a circle, parametrised by its length.

    Args:
        center_m: The centre (3,), metres.
        start_m: The start (3,), metres.
        normal: The unit vector (3,) about which the arc turns, perpendicular to the radius.
        angle_rad: The angle of the arc; negative for the opposite direction.

    Attributes:
        radius_m: The radius.
        length: The length of the arc, metres.
        shape: The name of the path in messages.
    """

    shape = "arc"

    def __init__(self, center_m: Vector, start_m: Vector, normal: Vector, angle_rad: float) -> None:
        self._center, self._out = center_m, start_m - center_m
        self._across = math.copysign(1.0, angle_rad) * np.cross(normal, self._out)
        self.radius_m = float(np.linalg.norm(self._out))
        self.length = self.radius_m * abs(angle_rad)

    @property
    def breakpoints(self) -> list[float]:
        """The distances along the arc of both ends: 0 and the length, metres."""
        return [0.0, self.length]

    def path_length(self) -> float:
        """Return the length of the arc, metres."""
        return self.length

    def at(self, distance: float) -> tuple[Vector, Vector, Vector]:
        """Compute the point and its first two derivatives (3,) at a distance along the arc."""
        angle = min(max(distance, 0.0), self.length) / self.radius_m
        out = math.cos(angle) * self._out + math.sin(angle) * self._across
        across = math.cos(angle) * self._across - math.sin(angle) * self._out
        return self._center + out, across / self.radius_m, -out / self.radius_m**2


def arc_through_points(
    start_m: Vector, via_m: ArrayLike, end_m: ArrayLike, *, full_circle: bool = False
) -> ArcPath:
    """Compute the arc from a start (3,) through a point to an end, metres.

    A ``full_circle`` passes ``end_m`` (3,) and continues to its start.

    Raises:
        BadValueError: Two points are the same, all points are collinear, or a number is not finite.
    """
    via = finite_vector(via_m, 3, "The via point of the arc")
    end = finite_vector(end_m, 3, "The end of the arc")
    pairs = {
        "the start, where the tip is, and the via point": (start_m, via),
        "the start, where the tip is, and the end": (start_m, end),
        "the via point and the end": (via, end),
    }
    for names, (one, other) in pairs.items():
        if float(np.linalg.norm(one - other)) < _SAME_POINT_M:
            raise BadValueError(
                "The arc", f"a point: {names} are the same", "three points on a circle"
            )
    a, b = via - start_m, end - start_m
    normal = np.cross(a, b)
    area2 = float(normal @ normal)
    longest = max(float(np.linalg.norm(side)) for side in (a, b, b - a))
    if math.sqrt(area2) < _MIN_HEIGHT_M * longest:
        raise BadValueError(
            "The via point of the arc",
            f"{format_point(via)}, on one line with the start {format_point(start_m)} "
            f"and the end {format_point(end)}",
            "a point off that line, or a straight line to the end",
        )
    out = (np.cross(normal, a) * (b @ b) + np.cross(b, normal) * (a @ a)) / (2.0 * area2)
    unit = normal / math.sqrt(area2)
    angle_rad = 2.0 * math.pi
    if not full_circle:
        angle_rad = math.atan2(float(unit @ np.cross(-out, b - out)), float(-out @ (b - out)))
        angle_rad %= 2.0 * math.pi
    return ArcPath(start_m + out, start_m, unit, angle_rad)


def arc_about_axis(
    start_m: Vector, center_m: ArrayLike, normal: ArrayLike, angle_rad: float
) -> ArcPath:
    """Compute the arc from a start (3,) [m] about an axis.

    The axis passes through ``center_m`` (3,) [m] along ``normal`` (3,), of any length. The circle
    starts at the start point and runs counter-clockwise about the normal; the given centre need not
    be in its plane.

    Raises:
        BadValueError: The start is on the axis, the normal is zero, the angle is zero or more than
            ten turns, or a number is not finite.
    """
    center = finite_vector(center_m, 3, "The centre of the circle")
    axis = finite_vector(normal, 3, "The normal of the circle")
    length = float(np.linalg.norm(axis))
    if not length > 0.0:
        raise BadValueError("The normal of the circle", "zero", "a direction such as (0, 0, 1)")
    if not 0.0 < abs(angle_rad) <= _MAX_ANGLE_RAD:
        expected = "an angle of up to ten turns that is not 0"
        raise BadValueError("The angle of the arc", f"{math.degrees(angle_rad):g}°", expected)
    axis = axis / length
    center = center + axis * float(axis @ (start_m - center))
    radius_m = float(np.linalg.norm(start_m - center))
    if radius_m < _MIN_RADIUS_M:
        found = f"{1000.0 * radius_m:.2f} mm, because the tip is on its axis"
        raise BadValueError("The radius of the circle", found, "a centre away from the tip")
    return ArcPath(center, start_m, axis, angle_rad)

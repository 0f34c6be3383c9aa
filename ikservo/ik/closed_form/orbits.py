"""Where points and vectors go as they turn about an axis, seen from the arm's plane.

The plane is a (3, 3) ``frame`` with rows e1, e2, n: a vector is e1 + i e2 *along* the plane and n
*across* it. Turning the parallel joints of the arm never changes what is across, which is why yaw
and roll can be found before them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from ikservo.ik.closed_form.angles import where
from ikservo.kinematics.se3 import Matrix, Vector, skew

__all__ = ["Orbit", "Spin", "frame_across"]


@dataclass(frozen=True, slots=True)
class Orbit:
    """A circle: ``along(θ) = A0 + A1 cos θ + A2 sin θ``, across likewise with a0, a1, a2."""

    A0: complex
    A1: complex
    A2: complex
    a0: float
    a1: float
    a2: float

    def along(self, theta_rad: float) -> complex:
        """Return the part in the plane, e1 + i e2."""
        return self.A0 + self.A1 * math.cos(theta_rad) + self.A2 * math.sin(theta_rad)

    def across(self, theta_rad: float) -> float:
        """Return the part along the plane's normal."""
        return self.a0 + self.a1 * math.cos(theta_rad) + self.a2 * math.sin(theta_rad)

    def slope(self, theta_rad: float) -> float:
        """Return how fast ``across`` changes with θ."""
        return self.a2 * math.cos(theta_rad) - self.a1 * math.sin(theta_rad)

    def where_across(self, value: float) -> tuple[float, ...] | None:
        """Return the angles at which ``across`` has the value; None where every angle has it."""
        return where(self.a1, self.a2, value - self.a0)

    @property
    def sway(self) -> float:
        """Return how far the circle leaves its middle across the plane."""
        return math.hypot(self.a1, self.a2)


class Spin:
    """Turns about one axis, prepared: ``R(θ) x = a (a·x) + cos θ (x - a (a·x)) + sin θ a × x``.

    Without an axis nothing moves.
    """

    __slots__ = ("_map", "_shift")

    def __init__(
        self, frame: Matrix, axis: Vector | None = None, point: Vector | None = None
    ) -> None:
        a = np.zeros(3) if axis is None else axis
        kept = np.eye(3) if axis is None else np.outer(a, a)
        self._map = np.vstack([frame @ kept, frame @ (np.eye(3) - kept), frame @ skew(a)])
        self._shift = np.zeros(9)
        if point is not None:
            self._shift -= self._map @ point
            self._shift[:3] += frame @ point

    def of_point(self, x: Vector) -> Orbit:
        """Return the orbit of a point (3,), m."""
        return _orbit(self._map @ x + self._shift)

    def of_vector(self, v: Vector) -> Orbit:
        """Return the orbit of a vector (3,)."""
        return _orbit(self._map @ v)


def frame_across(n: Vector) -> Matrix:
    """Return rows e1, e2, n: e1 as near as possible to x, or to z where n is x."""
    forward = np.array([0.0, 0.0, 1.0] if abs(n[0]) > 0.9 else [1.0, 0.0, 0.0])
    e1 = forward - n * float(forward @ n)
    e1 /= np.sqrt(e1 @ e1)
    return np.vstack([e1, np.cross(n, e1), n])


def _orbit(rows: Vector) -> Orbit:
    x0, y0, z0, x1, y1, z1, x2, y2, z2 = rows.tolist()
    return Orbit(complex(x0, y0), complex(x1, y1), complex(x2, y2), z0, z1, z2)

"""Feedback of tracking errors into goals: proportional, derivative and integral action."""

from __future__ import annotations

import numpy as np

from ikservo.kinematics.arrays import Vector

__all__ = ["TrackingFeedback"]


# Gears that break loose run ahead of a slow reference, and friction that falls with speed lets a
# loaded joint swing about it: the derivative brakes both. At twice these gains an XL330 swings by
# itself, for a goal acts a cycle after the measurement.
_PROPORTIONAL, _DERIVATIVE_S = 0.5, 0.05
# A tick more in one cycle looks like a high speed; the derivative is that of this filter.
_FILTER_S = 0.02
# Integral action takes up what masses, payload and servos differ by from the model; slower than
# any arm swings. Its limit is the sag of a joint at its torque limit, at the horn.
_INTEGRAL_PER_S, _MAX_INTEGRAL_RAD = 3.0, 0.08


class TrackingFeedback:
    """Computes by how much goals change for how far joints are off their reference.

    ``offset = kp e + kd de/dt + ki integral(e)``, with ``de/dt`` of the filtered error.

    Args:
        per_horn_rad: Motion of each joint for one radian of its horn (n,), rad or m.

    Attributes:
        integral: The integral part (n,), rad or m; it outlasts a motion.
    """

    def __init__(self, per_horn_rad: Vector) -> None:
        self._max_integral = _MAX_INTEGRAL_RAD * per_horn_rad
        self.integral = np.zeros_like(per_horn_rad)
        self.begin()

    @property
    def offset(self) -> Vector:
        """Return all parts together (n,), rad or m."""
        return self.integral + self._fast

    def reset(self) -> None:
        """Discard everything: torque was off."""
        self.integral = np.zeros_like(self.integral)
        self.begin()

    def begin(self) -> None:
        """Discard all but the integral: a motion begins."""
        self._fast = np.zeros_like(self.integral)
        self._filtered: Vector | None = None

    def update(self, error: Vector, elapsed_s: float, *, grow: bool) -> None:
        """Take the errors (n,) of one cycle, rad or m.

        Args:
            error: Reference minus joint.
            elapsed_s: Since the last one.
            grow: False where the goals were cut: then no part moves them further away.
        """
        filtered = error if self._filtered is None else self._filtered
        self._filtered = filtered + min(elapsed_s / _FILTER_S, 1.0) * (error - filtered)
        fast = _PROPORTIONAL * error + _DERIVATIVE_S / _FILTER_S * (error - self._filtered)
        change = _INTEGRAL_PER_S * elapsed_s * error
        if not grow:
            fast = np.clip(fast, np.minimum(self._fast, 0.0), np.maximum(self._fast, 0.0))
            change[change * self.integral > 0.0] = 0.0
        self._fast = fast
        self.integral = np.clip(self.integral + change, -self._max_integral, self._max_integral)

"""Feedback from tracking errors to goals: proportional, derivative, integral, friction."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ikservo.control.reversal_counter import ReversalCounter
from ikservo.kinematics.arrays import Vector

# A servo is a spring to its goal, so proportional and derivative parts act like stiffness and
# damping of the joint. Light joints are softened and heavy ones stiffened, so that each would swing
# at the same rate without damping. docs/decisions/0020 says why this drives no swing in the
# backlash, docs/how-control-works.md how the numbers were chosen. Angles are those of the horn.
_SWING_RAD_S = 18.0  # rate at which a joint would swing without damping
_BRAKING_PER_S = 28.0  # rate at which damping slows a swing; with 45 an STS3215 swings by itself
_PROPORTIONAL_RANGE = (-0.5, 0.5)  # rad per rad: limits for joints of uncertain inertia
_DERIVATIVE_RANGE_S = (0.03, 0.12)  # such limits, too; at 0.12, a tick moves the goal by six
# These are added for a joint whose gears the weight of the links presses to one flank, because
# heavy joints would lag without them.
_PRESSED_RAD_S = 12.0  # added to the rate of the swing
_PRESSED_PER_S = 12.0  # added to the rate of the damping
_PRESSED_PROPORTIONAL = 1.0  # rad per rad: added to both limits of the proportional part
_FILTER_S = 0.015  # filter of the derivative: a tick in a cycle looks like a high speed
# Limits of both parts together: damping a swing needs less, and goals must not jump after lost
# replies, or if a joint sagged before its motion began.
_MAX_FAST_RAD = 0.04  # largest size
_MAX_FAST_RAD_S = 1.0  # largest rate
_STALE_S = 0.03  # after this time without a reply both parts fade
_INTEGRAL_PER_S = 3.0  # slower than any arm swings; learns errors of masses, payload and servos
_MAX_INTEGRAL_RAD = 0.08  # sag of a joint at its torque limit
# Friction that differs from the model: wear, variation between servos, and friction behind the
# backlash.
_FRICTION_PER_S = 2.0  # rate of learning; four times as fast takes loads for friction
_FRICTION_RAD = (-0.01, 0.03)  # limits of what is learned
# Goals act some milliseconds after the measurement, so the derivative would drive a swing of more
# than 8 Hz: an error that reverses repeatedly.
_SWING_RAD = 0.007  # an error that reverses by more than this
_SWING_S = 0.06  # within this time of the previous reversal: half a period of 8 Hz
_MIN_TURNS = 2  # more reversals than this are a swing
_SWING_SHARE = 0.5  # fraction of the fast feedback that each further reversal leaves
_RECOVERY_S = 20.0  # time in which the fast feedback returns completely
_MAX_STEP_S = 0.02  # a late cycle counts as at most this long: goals must not jump after a stall


class TrackingFeedback:
    """Computation of the change of goals from the joints' errors relative to their reference.

    ``fast = kp e + kd de/dt`` is added to the goals, with ``de/dt`` of the filtered error. This sum
    and its rate of change are bounded, and the sum fades if a joint swings. The integral is a load
    missing from the model. Goals lead by this load and by the gear friction that it causes, so that
    a load learned while a joint sinks is also lifted. The integral grows so that goals move by ``ki
    e`` per second. Friction beyond the model's is learned while joints move, from the error along
    their motion (Friedland and Park 1992, "On adaptive friction compensation").

    Args:
        per_horn_rad: Motion of each joint per radian of its horn (n,), rad or m.

    Attributes:
        integral: The load (n,), as the lag that it would cause without friction, rad or m; kept
            after a motion.
        friction: The lag (n,) by which friction exceeds the model's, rad or m; kept after a motion.
        fast: Sum of the proportional and derivative parts (n,).
    """

    def __init__(self, per_horn_rad: Vector) -> None:
        self._max_fast = _MAX_FAST_RAD * per_horn_rad
        self._max_fast_s = _MAX_FAST_RAD_S * per_horn_rad
        self._max_integral = _MAX_INTEGRAL_RAD * per_horn_rad
        self._least_friction, self._most_friction = (r * per_horn_rad for r in _FRICTION_RAD)
        self._turns = ReversalCounter(_SWING_RAD * per_horn_rad, _SWING_S)
        self.adapt(np.zeros_like(per_horn_rad), np.zeros_like(per_horn_rad))
        self.reset()

    def reset(self) -> None:
        """Discard everything, because torque was off."""
        self.integral = np.zeros_like(self._max_integral)
        self.friction = np.zeros_like(self._max_integral)
        self._fast_share = np.ones_like(self._max_integral)
        self.begin()

    def begin(self) -> None:
        """Discard all state except load, friction and swing counts at the beginning of a motion."""
        self.fast = np.zeros_like(self.integral)
        self._filtered = np.full_like(self.integral, np.nan)
        self._age_s = np.zeros_like(self.integral)
        self._turns.begin()

    def adapt(self, inertia_s2: Vector, pressed: Vector) -> None:
        """Choose the gains.

        Args:
            inertia_s2: The inertia of each joint over its stiffness (n,), s²; 0 if not known.
            pressed: The certainty (n,), 0 to 1, that weight keeps a joint's gears on one flank.
        """
        low, high = (end + _PRESSED_PROPORTIONAL * pressed for end in _PROPORTIONAL_RANGE)
        stiffer = np.square(_SWING_RAD_S + _PRESSED_RAD_S * pressed) * inertia_s2 - 1.0
        self._proportional = np.where(inertia_s2 > 0.0, np.clip(stiffer, low, high), 0.0)
        braking_per_s = _BRAKING_PER_S + _PRESSED_PER_S * pressed
        self._derivative_s = np.clip(braking_per_s * inertia_s2, *_DERIVATIVE_RANGE_S)

    def update(
        self,
        error: Vector,
        left: Vector | float,
        elapsed_s: float,
        *,
        fresh: NDArray[np.bool_] | bool = True,
        grow: Vector | float,
        slope: Vector | float = 1.0,
        direction: Vector | float = 0.0,
    ) -> None:
        """Process the errors (n,) of one cycle, rad or m.

        Args:
            error: Reference minus joint.
            left: Errors up to this size (n,), in either direction, are ignored.
            elapsed_s: Time since the last cycle.
            fresh: Whether each joint (n,) was read; the errors of other joints are unknown.
            grow: The rate at which the parts of each goal (n,) may move it further away, 0 to 1.
            slope: The displacement of goals (n,) per rad of the integral.
            direction: The direction in which joints (n,) move, -1 to 1; 0 for joints at rest.
        """
        self._age_s = self._age_s + elapsed_s
        turned = self._turns.update(error, elapsed_s, fresh=fresh)
        swung = turned & (self._turns.count > _MIN_TURNS)
        recovered = np.minimum(self._fast_share + elapsed_s / _RECOVERY_S, 1.0)
        self._fast_share = np.where(swung, _SWING_SHARE * self._fast_share, recovered)
        beyond = np.where(fresh, error - np.clip(error, -left, left), 0.0)
        step_s = min(elapsed_s, _MAX_STEP_S)
        most = self._max_fast_s * step_s
        fast = np.clip(self._next_fast(error, beyond, fresh), self.fast - most, self.fast + most)
        inward = np.clip(fast, np.minimum(self.fast, 0.0), np.maximum(self.fast, 0.0))
        self.fast = inward + grow * (fast - inward)
        change = _INTEGRAL_PER_S * step_s * beyond / slope
        load = self.integral
        back = np.clip(load + change, np.minimum(load, 0.0), np.maximum(load, 0.0))
        on = load + change - back  # what remains of the change once the load is zero
        self.integral = np.clip(back + grow * on, -self._max_integral, self._max_integral)
        learned = self.friction + _FRICTION_PER_S * step_s * np.where(fresh, error * direction, 0.0)
        inward = np.minimum(learned, self.friction)
        learned = inward + grow * (learned - inward)
        self.friction = np.clip(learned, self._least_friction, self._most_friction)
        self._age_s = np.where(fresh, 0.0, self._age_s)

    def _next_fast(self, error: Vector, beyond: Vector, fresh: NDArray[np.bool_] | bool) -> Vector:
        """Return the fast correction (n,): proportional and derivative parts.

        Joints without a reply keep their values for a short time.
        """
        first = np.isnan(self._filtered)
        self._filtered = np.where(first & fresh, error, self._filtered)
        rate = (error - self._filtered) / (self._age_s + _FILTER_S)
        self._filtered = np.where(fresh, self._filtered + self._age_s * rate, self._filtered)
        braking = np.where(beyond != 0.0, self._derivative_s * rate, 0.0)
        fast = self._fast_share * (self._proportional * beyond + braking)
        read = np.clip(fast, -self._max_fast, self._max_fast)
        return np.where(fresh, read, np.where(self._age_s > _STALE_S, 0.0, self.fast))

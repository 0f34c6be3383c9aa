"""Measure amplitude ratio and phase lag of a servo on a sine of constant or rising frequency."""

from __future__ import annotations

import math
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from ikservo.apps.workbench.gain_search import (
    REST_S,
    find_free_motion,
    record_joint,
    swing_at_rest,
)
from ikservo.arm.arm import Arm
from ikservo.errors import BadValueError, RefusedError
from ikservo.kinematics.arrays import FrozenArrays, Vector
from ikservo.motion import TrajectoryPoint

DEFAULT_AMPLITUDE_RAD = math.radians(2.0)
_LEAST_AMPLITUDE_RAD = np.radians(0.5) - 1e-9
_FREQUENCIES_HZ = (0.1, 20.0)
_CYCLES = 8.0  # number of cycles at a single frequency
_WINDOW_CYCLES = 3.0  # cycles of a sweep per half octave
_FADE_CYCLES = 1.5  # cycles for the rise and the fall of the amplitude
_STEP_S = 0.0005  # time between two points of a motion


@dataclass(frozen=True, slots=True)
class FrequencyPoint:
    """Response of a joint at one frequency: amplitude ratio to its goal, and lag behind it."""

    frequency_hz: float
    amplitude_ratio: float
    phase_lag_rad: float


class SineMotion:
    """Sine motion of a joint about its start, with an exponentially rising frequency.

    Args:
        start: The joints (n,).
        column: The column of the joint that moves.
        amplitude_rad: The amplitude.
        from_hz: The lowest frequency.
        to_hz: The highest frequency; equal to the lowest for a single one.

    Attributes:
        windows: Intervals [s] with full amplitude, one per half octave.
        top_rad_s: The highest speed of the joint.
        top_rad_s2: The highest acceleration of the joint.
    """

    def __init__(
        self, start: Vector, column: int, amplitude_rad: float, from_hz: float, to_hz: float
    ) -> None:
        self.start, self._own = start, np.arange(len(start)) == column
        octaves = math.log2(to_hz / from_hz)
        window_s = _WINDOW_CYCLES * math.log(2) / 2 / (math.sqrt(2) - 1) / from_hz
        sweep_s = 2 * octaves * window_s + _CYCLES / to_hz
        self._from_hz, self._rate = from_hz, math.log(to_hz / from_hz) / sweep_s
        self.duration_s = sweep_s + REST_S
        rise_s, fall_s = _FADE_CYCLES / from_hz, _FADE_CYCLES / to_hz
        edges = np.linspace(rise_s, sweep_s - fall_s, max(round(2 * octaves), 1) + 1)
        self.windows = list(pairwise(edges.tolist()))
        self._times = np.arange(0.0, self.duration_s, _STEP_S)
        x = np.clip(np.minimum(self._times / rise_s, (sweep_s - self._times) / fall_s), 0.0, 1.0)
        envelope = amplitude_rad * x**3 * (10 - 15 * x + 6 * x * x)  # with zero slope at both ends
        angle = envelope * np.sin(self.phase_rad(self._times))
        speed = np.gradient(angle, _STEP_S)
        self._moved = angle, speed, np.gradient(speed, _STEP_S)
        self.top_rad_s, self.top_rad_s2 = (float(np.abs(each).max()) for each in self._moved[1:])

    def frequency_hz(self, time_s: float) -> float:
        """Return the frequency at a time."""
        return self._from_hz * math.exp(self._rate * time_s)

    def phase_rad(self, time_s: Vector) -> Vector:
        """Return the phase (m,) of the sine at times (m,)."""
        if self._rate == 0.0:
            return math.tau * self._from_hz * time_s
        return math.tau * self._from_hz / self._rate * np.expm1(self._rate * time_s)

    def state(self, time_s: float) -> TrajectoryPoint:
        """Return position, velocity and acceleration (n,) at a time."""
        q, v, a = (np.interp(time_s, self._times, each) * self._own for each in self._moved)
        return TrajectoryPoint(self.start + q, v, a)


@dataclass(frozen=True, slots=True, eq=False)
class SineResponse(FrozenArrays):
    """Response of a joint to a sine, without corrections by ikservo.

    Attributes:
        time_s: The times of the motion (m,).
        goal_rad: The goals of the servo (m,).
        position_rad: Measured positions (m,).
        sine: The motion.
    """

    time_s: Vector
    goal_rad: Vector
    position_rad: Vector
    sine: SineMotion

    @property
    def points(self) -> list[FrequencyPoint]:
        """The responses of the joint, one per half octave of a sweep."""
        points: list[FrequencyPoint] = []
        for start_s, end_s in self.sine.windows:
            rows = (self.time_s >= start_s) & (self.time_s <= end_s)
            time_s = self.time_s[rows]
            phase = self.sine.phase_rad(time_s)
            basis = np.column_stack([np.cos(phase), np.sin(phase), np.ones_like(phase), time_s])
            both = np.column_stack([self.goal_rad[rows], self.position_rad[rows]])
            found, *_ = np.linalg.lstsq(basis, both, rcond=None)
            goal, position = found[1] + 1j * found[0]
            ratio = position / goal
            lag_rad = (-np.angle(ratio) + 0.5) % math.tau - 0.5  # a small lead is a negative lag
            middle_hz = self.sine.frequency_hz((start_s + end_s) / 2)
            points.append(FrequencyPoint(middle_hz, float(abs(ratio)), float(lag_rad)))
        return points

    @property
    def swing_rad(self) -> float:
        """Peak-to-peak motion at rest after the sine."""
        return swing_at_rest(self.time_s, self.position_rad, self.sine.duration_s)


def measure_sine(
    arm: Arm, joint: str, amplitude_rad: float, from_hz: float, to_hz: float
) -> SineResponse:
    """Move a joint on a sine around its position, and return the response of its servo.

    ikservo's own corrections are off, so that only the servo with its gains is measured. The
    frequency sweeps from ``from_hz`` to ``to_hz``, unless they are equal; other joints hold.

    Raises:
        BadValueError: The amplitude is smaller than 0.5°, or a frequency is out of range.
        RefusedError: There is no room, the joint would be too fast, or something is in the way;
            nothing moved.
        IkservoError: The errors of every motion; see ``Arm``.
    """
    lowest_hz, highest_hz = _FREQUENCIES_HZ
    if not lowest_hz <= from_hz <= to_hz <= highest_hz:
        wanted = f"two frequencies from {lowest_hz:g} to {highest_hz:g} Hz, the lower one first"
        raise BadValueError("The frequency", f"{from_hz:g} to {to_hz:g} Hz", wanted)
    if not amplitude_rad >= _LEAST_AMPLITUDE_RAD:
        raise BadValueError("The amplitude", f"{np.degrees(amplitude_rad):.3g}°", "at least 0.5°")
    context, column = arm.context, arm.context.index.names.index(joint)
    lower, upper = (limit[column] for limit in context.limits())
    start = context.servos.measure_positions()
    at_rad = start[column]
    if not lower <= at_rad - amplitude_rad <= at_rad + amplitude_rad <= upper:
        raise RefusedError(
            f"{joint} has no room for {np.degrees(amplitude_rad):.3g}° on both sides.",
            "Move it away from its limits, or choose a smaller amplitude.",
        )
    limits = context.planner.motion_limits("fast")[column]
    motion = SineMotion(start, column, amplitude_rad, from_hz, to_hz)
    if motion.top_rad_s > limits.speed_rad_s or motion.top_rad_s2 > limits.acceleration_rad_s2:
        needed, allowed = (
            f"{math.degrees(speed):.0f}°/s and {math.degrees(acceleration):.0f}°/s²"
            for speed, acceleration in (
                (motion.top_rad_s, motion.top_rad_s2),
                (limits.speed_rad_s, limits.acceleration_rad_s2),
            )
        )
        raise RefusedError(
            f"{joint} would need {needed}; its limits are {allowed}.",
            "Choose a smaller amplitude or a lower frequency.",
        )
    made: list[SineMotion] = []

    def make_motion(start: Vector) -> SineMotion:
        made.append(SineMotion(start, column, amplitude_rad, from_hz, to_hz))
        return find_free_motion(context, made)

    return SineResponse(*record_joint(arm, column, make_motion), made[0])

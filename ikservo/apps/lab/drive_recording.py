"""Recordings of servos during a motion, and means over windows of steady speed."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector

Cube = NDArray[np.float64]
"""Array with three axes: samples, joints, servos of each joint."""

_WINDOW_S = 0.2
_SETTLED_S = 0.12  # wait after a change of speed, until the servo's profile and loop have settled
_STEADY_RAD_S = 0.004  # largest change of speed in a window, or 3 % of the speed if that is more
_MAX_LAG = 0.25  # largest lag in a window, as a fraction of the travel of its goals
_MIN_RAD_S = 0.04  # slower joints stick and slip


@dataclass(frozen=True, slots=True, eq=False)
class DriveRecording(FrozenArrays):
    """Samples of the chain's joints, and of up to ``most`` servos of each joint.

    Attributes:
        time_s: Times (m,) of the readings.
        leg: The part of the motion to which each sample belongs (m,).
        speed: The speed of the reference (m, dof), rad/s or m/s.
        goal: Goals (m, dof), rad or m.
        position: Positions measured together with the duty (m, dof), rad or m.
        duty: Fraction of the full duty (m, dof, most), -1 to 1, positive towards increasing
            positions. NaN for a servo that a joint does not have.
        current_a: Current of the winding (m, dof, most), or its magnitude if the servo does not
            measure the sign; NaN if it measures no current.
        voltage_v: Voltage at the servo (m, dof, most).
        goal_age_s: Age (m, dof) of a joint's goal when its servos were read, minus the mean age and
            the time that its profile needs, seconds.
    """

    time_s: Vector
    leg: NDArray[np.int64]
    speed: Matrix
    goal: Matrix
    position: Matrix
    duty: Cube
    current_a: Cube
    voltage_v: Cube
    goal_age_s: Matrix


@dataclass(frozen=True, slots=True, eq=False)
class SteadyWindows:
    """Means over windows in which one joint moves steadily; one row per window (k,).

    Attributes:
        joint: The joint's index.
        leg: The part of the motion.
        q: All joints of the chain (k, dof).
        speed: The joint speed, rad/s.
        lead: Goal minus position, rad.
        goal_age_s: See `DriveRecording`.
        duty: Fraction of the full duty of each servo of the joint (k, most).
        current_a: Current of each servo (k, most); see `DriveRecording`.
        voltage_v: Voltage at each servo (k, most).
    """

    joint: NDArray[np.int64]
    leg: NDArray[np.int64]
    q: Matrix
    speed: Vector
    lead: Vector
    goal_age_s: Vector
    duty: Matrix
    current_a: Matrix
    voltage_v: Matrix

    @property
    def joint_duty(self) -> Vector:
        """Mean duty (k,) of the servos of the joint."""
        duty: Vector = np.nanmean(self.duty, axis=1)
        return duty

    def of_joint(self, joint: int) -> SteadyWindows:
        """Return the windows of a joint."""
        return self.where(self.joint == joint)

    def where(self, mask: NDArray[np.bool_]) -> SteadyWindows:
        """Return the selected windows."""
        return SteadyWindows(
            *(getattr(self, name)[mask] for name in SteadyWindows.__dataclass_fields__)
        )


def steady_windows(recording: DriveRecording) -> SteadyWindows:
    """Return the means over all windows of steady motion of all joints."""
    rows = [
        _mean_row(recording, joint, window)
        for joint in range(recording.goal.shape[1])
        for window in _windows_of(recording, joint)
    ]
    columns = [np.array(column) for column in zip(*rows, strict=True)]
    return SteadyWindows(*columns)


def smooth_samples(samples: Matrix) -> Matrix:
    """Replace each sample (m, n) by the mean of the nine samples around it."""
    padded = np.pad(samples, ((4, 4), (0, 0)), mode="edge")
    kernel = np.ones(9) / 9.0
    return np.column_stack([np.convolve(column, kernel, "valid") for column in padded.T])


def _windows_of(recording: DriveRecording, joint: int) -> list[slice]:
    """Return windows in which a joint has had a steady speed for a while."""
    found, speed = list[slice](), recording.speed[:, joint]
    since = first = 0
    for k in range(1, len(speed)):
        steady = abs(speed[k] - speed[since]) < max(_STEADY_RAD_S, 0.03 * abs(speed[since]))
        if not steady or recording.leg[k] != recording.leg[since] or abs(speed[k]) < _MIN_RAD_S:
            since = first = k
            continue
        if recording.time_s[k] - recording.time_s[since] < _SETTLED_S:
            first = k
        elif recording.time_s[k] - recording.time_s[first] >= _WINDOW_S:
            # After a reversal a joint sticks for a while and does not move like its goals.
            window = slice(first, k)
            moved = np.ptp(recording.position[window, joint])
            asked = np.ptp(recording.goal[window, joint])
            if abs(moved - asked) < _MAX_LAG * asked:
                found.append(window)
            first = k
    return found


def _mean_row(recording: DriveRecording, joint: int, window: slice) -> tuple[object, ...]:
    times = recording.time_s[window] - recording.time_s[window].mean()
    # A joint whose load changes does not move at the speed of its goals.
    speed = times @ recording.position[window, joint] / (times @ times)
    return (
        joint,
        int(recording.leg[window][0]),
        recording.position[window].mean(axis=0),
        float(speed),
        float((recording.goal - recording.position)[window, joint].mean()),
        float(recording.goal_age_s[window, joint].mean()),
        recording.duty[window, joint].mean(axis=0),
        recording.current_a[window, joint].mean(axis=0),
        recording.voltage_v[window, joint].mean(axis=0),
    )

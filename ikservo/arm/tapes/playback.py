"""A recorded motion of joints as a course: smoothed, and no faster than the joints may go."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from ikservo.guard import thin_path
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.motion import JointMove, Pace, State

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

__all__ = ["Playback"]

_GRID_S = 0.02
# Ticks and the hand's tremor are gone below a tenth of a second; what was meant is slower.
_SMOOTH_S = 0.04
# It fades in and out: its rate goes from 0 to 1, per second and second.
_FADE = Pace(1.0, 1.0, 8.0)
_MARGIN = 1.02


class Playback:
    """The motion through recorded samples, from rest at the first to rest at the last.

    Args:
        times_s: When they were taken (k,), growing.
        joints: Where the joints were (k, n), rad or m.
        paces: The pace of each joint; where the recording is faster, all of it goes slower.
        lower: The lowest positions (n,) it may reach.
        upper: The highest.

    Attributes:
        slower: How many times slower than recorded it goes, 1 where it need not.
    """

    def __init__(
        self, times_s: Vector, joints: Matrix, paces: Sequence[Pace], lower: Vector, upper: Vector
    ) -> None:
        self._limits = lower, upper
        self._span_s = float(times_s[-1] - times_s[0])
        self._still = np.clip(joints[-1], lower, upper)
        self.slower = 1.0
        self._spline: CubicSpline | None = None
        if self._span_s >= _GRID_S:
            self._spline = _smoothed(times_s - times_s[0], joints, self._span_s)
        else:  # no motion, but a pose
            self._law = JointMove([0.0], [0.0], [_FADE])
            return
        self.slower = _needed(self._spline, self._span_s, paces)
        fade = Pace(1 / self.slower, _FADE.acceleration_rad_s2 / self.slower**2,
                    _FADE.jerk_rad_s3 / self.slower**3)  # fmt: skip
        self._law = JointMove([0.0], [self._span_s], [fade])

    @property
    def start(self) -> Vector:
        """Return where it begins (n,)."""
        return self.state(0.0).position

    @property
    def duration_s(self) -> float:
        """Return how long it takes, fading in and out included."""
        return self._law.duration_s

    def state(self, time_s: float) -> State:
        """Return position, velocity and acceleration (n,) at a time; at rest after its end."""
        if self._spline is None:
            return State.rest(self._still)
        law = self._law.state(time_s)
        s, rate, change = (float(x[0]) for x in (law.position, law.velocity, law.acceleration))
        q, slope, bend = (np.asarray(self._spline(s, k)) for k in range(3))
        return State(np.clip(q, *self._limits), slope * rate, bend * rate**2 + slope * change)

    def way(self) -> Matrix:
        """Return joints (k, n) along it, no further apart than a body should be looked at."""
        if self._spline is None:
            return self._still[None, :]
        return thin_path(np.clip(self._spline(_grid(self._span_s)), *self._limits))


def _smoothed(times_s: Vector, joints: Matrix, span_s: float) -> CubicSpline:
    """Return the motion (n,) over the seconds since its first sample."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415  # slow to import, rarely needed
    from scipy.ndimage import gaussian_filter1d  # noqa: PLC0415

    grid = _grid(span_s)
    even = np.empty((len(grid), joints.shape[1]))
    for column, samples in enumerate(joints.T):
        even[:, column] = np.interp(grid, times_s, samples)
    width = _SMOOTH_S / float(grid[1])
    margin = min(4 * math.ceil(width), len(grid) - 1)
    # Beyond its ends the motion goes on as it came: anything else would be a jerk.
    longer = np.pad(even, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    smooth: Matrix = gaussian_filter1d(longer, width, axis=0)[margin:-margin]
    return CubicSpline(grid, smooth, bc_type="natural")


def _grid(span_s: float) -> Vector:
    return np.linspace(0.0, span_s, 2 + int(span_s / _GRID_S))


def _needed(spline: CubicSpline, span_s: float, paces: Sequence[Pace]) -> float:
    """Return how many times slower the recording has to go to keep to the paces."""
    grid = _grid(span_s)
    middles = (grid[:-1] + grid[1:]) / 2
    speed, bend, twist = (
        np.abs(np.asarray(spline(np.concatenate([grid, middles]), k))).max(axis=0)
        for k in (1, 2, 3)
    )
    slower = 1.0
    for i, pace in enumerate(paces):
        acceleration = bend[i] + speed[i] * _FADE.acceleration_rad_s2
        jerk = twist[i] + 3 * bend[i] * _FADE.acceleration_rad_s2 + speed[i] * _FADE.jerk_rad_s3
        slower = max(
            slower,
            _MARGIN * speed[i] / pace.speed_rad_s,
            _MARGIN * math.sqrt(acceleration / pace.acceleration_rad_s2),
            _MARGIN * math.cbrt(jerk / pace.jerk_rad_s3),
        )
    return slower

"""Replay a recording: smoothed, within the joint limits, checked by the guard."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from ikservo.arm.context import ArmContext
from ikservo.arm.recording import Recording, RecordingHeader, read_recording, recording_header
from ikservo.arm.reports import MotionProgress
from ikservo.arm.settling import settle_at
from ikservo.control.loop import ControlCycle
from ikservo.errors import FileFormatError, RefusedError
from ikservo.guard import thin_path
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.motion import JointMove, KinematicLimits, TrajectoryPoint

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

__all__ = ["RecordedTrajectory", "ReplayResult", "load_replay", "replay"]


_GRID_S = 0.02
# Ticks and the hand's tremor are gone below a tenth of a second; what was meant is slower.
_SMOOTH_S = 0.04
# It fades in and out: its rate goes from 0 to 1, per second and second.
_FADE = KinematicLimits(1.0, 1.0, 8.0)
_MARGIN = 1.02


class RecordedTrajectory:
    """The motion through recorded samples, from rest at the first to rest at the last.

    Args:
        times_s: When they were taken (k,), growing.
        joints: Where the joints were (k, n), rad or m.
        paces: The pace of each joint; where the recording is faster, all of it goes slower.
        lower: The lowest positions (n,) it may reach.
        upper: The highest.

    Attributes:
        slowdown: How many times slower than recorded it goes, 1 where it need not.
    """

    def __init__(
        self,
        times_s: Vector,
        joints: Matrix,
        paces: Sequence[KinematicLimits],
        lower: Vector,
        upper: Vector,
    ) -> None:
        self._limits = lower, upper
        self._span_s = float(times_s[-1] - times_s[0])
        self._still = np.clip(joints[-1], lower, upper)
        self.slowdown = 1.0
        self._spline: CubicSpline | None = None
        if self._span_s >= _GRID_S:
            self._spline = _fit_spline(times_s - times_s[0], joints, self._span_s)
        else:  # no motion, but a pose
            self._law = JointMove([0.0], [0.0], [_FADE])
            return
        self.slowdown = _required_slowdown(self._spline, self._span_s, paces)
        fade = KinematicLimits(1 / self.slowdown, _FADE.acceleration_rad_s2 / self.slowdown**2,
                    _FADE.jerk_rad_s3 / self.slowdown**3)  # fmt: skip
        self._law = JointMove([0.0], [self._span_s], [fade])

    @property
    def start(self) -> Vector:
        """Return where it begins (n,)."""
        return self.state(0.0).position

    @property
    def duration_s(self) -> float:
        """Return how long it takes, fading in and out included."""
        return self._law.duration_s

    def state(self, time_s: float) -> TrajectoryPoint:
        """Return position, velocity and acceleration (n,) at a time; at rest after its end."""
        if self._spline is None:
            return TrajectoryPoint.at_rest(self._still)
        law = self._law.state(time_s)
        s, rate, change = (float(x[0]) for x in (law.position, law.velocity, law.acceleration))
        q, slope, bend = (np.asarray(self._spline(s, k)) for k in range(3))
        return TrajectoryPoint(
            np.clip(q, *self._limits), slope * rate, bend * rate**2 + slope * change
        )

    def sample_path(self) -> Matrix:
        """Return joints (k, n) along it, no further apart than a body should be looked at."""
        if self._spline is None:
            return self._still[None, :]
        return thin_path(np.clip(self._spline(_time_grid(self._span_s)), *self._limits))


def _fit_spline(times_s: Vector, joints: Matrix, span_s: float) -> CubicSpline:
    """Return the motion (n,) over the seconds since its first sample."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415  # slow to import, rarely needed
    from scipy.ndimage import gaussian_filter1d  # noqa: PLC0415

    grid = _time_grid(span_s)
    even = np.empty((len(grid), joints.shape[1]))
    for column, samples in enumerate(joints.T):
        even[:, column] = np.interp(grid, times_s, samples)
    width = _SMOOTH_S / float(grid[1])
    margin = min(4 * math.ceil(width), len(grid) - 1)
    # Beyond its ends the motion goes on as it came: anything else would be a jerk.
    longer = np.pad(even, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    smooth: Matrix = gaussian_filter1d(longer, width, axis=0)[margin:-margin]
    return CubicSpline(grid, smooth, bc_type="natural")


def _time_grid(span_s: float) -> Vector:
    return np.linspace(0.0, span_s, 2 + int(span_s / _GRID_S))


def _required_slowdown(
    spline: CubicSpline, span_s: float, paces: Sequence[KinematicLimits]
) -> float:
    """Return how many times slower the recording has to go to keep to the paces."""
    grid = _time_grid(span_s)
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


# A hand presses joints a little past where their limits were set.
_LIMIT_TOLERANCE_RAD = math.radians(3.0)


@dataclass(frozen=True, slots=True, eq=False)
class ReplayResult:
    """How a recording was played back.

    Attributes:
        samples: How many it has.
        duration_s: How long playing it took.
        slower: How many times slower than recorded, because it was faster than the arm may go.
        error_rad: The furthest that a joint is from the last sample, rad or m.
        measured_rad: Where the joints are in the end, rad or m by name.
        measured_tip_m: Where that puts the tip (3,), metres.
    """

    samples: int
    duration_s: float
    slower: float
    error_rad: float
    measured_rad: dict[str, float]
    measured_tip_m: Vector


def load_replay(
    arm: ArmContext, path: Path | str, speed: str
) -> tuple[Recording, RecordedTrajectory]:
    """Read a recording of this arm and make a motion of it; nothing moves.

    Raises:
        FileFormatError: It is spoiled, or of another arm.
        RefusedError: It leaves the joints' limits, or the body would touch something.
    """
    recording = read_recording(path)
    _check_recorded_arm(arm, recording.heading, Path(path))
    _check_limits(arm, recording, Path(path))
    lower, upper = arm.limits()
    paces = arm.planner.motion_limits(speed)
    playback = RecordedTrajectory(recording.times_s, recording.joints, paces, lower, upper)
    arm.check_recorded_path(playback.sample_path())
    return recording, playback


def replay(
    arm: ArmContext,
    path: Path | str,
    speed: str,
    on_progress: Callable[[MotionProgress], None] | None,
) -> ReplayResult:
    """Play a recording back from its first pose; see ``Arm.replay``."""
    recording, playback = load_replay(arm, path, speed)
    at_first = arm.allowed_speed(speed)
    paces = arm.planner.motion_limits(at_first)
    started_s = arm.now_s()

    def approach(here: Vector) -> JointMove:
        arm.check_recorded_path(arm.interpolate_joints(here, playback.start))
        return JointMove(here, playback.start, paces)

    def on_cycle(beat: ControlCycle) -> None:
        if on_progress:
            on_progress(arm.progress(beat))

    arm.drive(approach, on_cycle, at_first)
    arm.drive(lambda _: playback, on_cycle, speed)
    goal = playback.state(playback.duration_s).position
    measured = settle_at(arm, goal, speed)
    return ReplayResult(
        samples=len(recording.times_s),
        duration_s=arm.now_s() - started_s,
        slower=playback.slowdown,
        error_rad=float(np.abs(measured - goal).max()),
        measured_rad=dict(zip(arm.servos.names, measured.tolist(), strict=True)),
        measured_tip_m=arm.planner.tip(measured),
    )


def _check_recorded_arm(arm: ArmContext, heading: RecordingHeader, path: Path) -> None:
    own = recording_header(arm.model, heading.period_s)
    for what, found, wanted in (
        ("arm", heading.arm, own.arm),
        ("joints", ", ".join(heading.joints), ", ".join(own.joints)),
        ("units", ", ".join(heading.units), ", ".join(own.units)),
    ):
        if found != wanted:
            raise FileFormatError(path, "line 1", f"is of {what} {found}", f"{what} {wanted}")


def _check_limits(arm: ArmContext, recording: Recording, path: Path) -> None:
    """Refuse a recording that leaves the limits by more than a hand presses joints past them."""
    for column, fence in enumerate(arm.servos.fences):
        slack = _LIMIT_TOLERANCE_RAD * fence.joint_map.unit_per_horn_rad
        low, high = fence.position_range
        values = recording.joints[:, column]
        beyond = np.flatnonzero((values < low - slack) | (values > high + slack))
        if len(beyond):
            first = int(beyond[0])
            words = fence.describe_violation(fence.joint_map.tick(float(values[first])))
            raise RefusedError(
                f"{path}, line {first + 2}: {words}",
                "Nothing moved. Remove the samples that cannot be replayed.",
            )

"""Replay a recording: smoothed, within the joint limits, checked by the guard."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import KW_ONLY, dataclass, replace
from os import fspath
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import numpy as np

from ikservo.apps.teaching.recorder import read_recording, recording_header
from ikservo.apps.teaching.recording import Recording
from ikservo.arguments import check_flag
from ikservo.arm.arm_protocol import ArmParts, OpenArm
from ikservo.arm.background_motion import RunningMotion
from ikservo.arm.opening import require_own_port
from ikservo.arm.own_motion import OwnMotion
from ikservo.arm.plan_execution import execute, plan_and_execute
from ikservo.control.stillness import StillnessDetector, read_until_at_rest
from ikservo.errors import CollisionError, FileFormatError, RefusedError
from ikservo.files.reading import parse_path
from ikservo.guard import thin_path
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.motion import (
    ConcatenatedTrajectory,
    JointMove,
    KinematicLimits,
    Trajectory,
    TrajectoryPoint,
)
from ikservo.planning.context import ArmContext
from ikservo.planning.motion_plan import MotionPlan, sample_states
from ikservo.planning.motions import MoveJoints, Speed
from ikservo.planning.poses import PoseLibrary
from ikservo.planning.preflight_planner import PlannedStart, PreflightPlanner
from ikservo.planning.reports import OnProgress, ReplayResult
from ikservo.settling.settling import settle_at

if TYPE_CHECKING:
    from scipy.interpolate import CubicSpline

_GRID_S = 0.02
# Smoothing removes quantization and tremor below 0.1 s; intended motions are slower.
_SMOOTH_S = 0.04
# Limits on the playback rate, which goes from 0 to 1 and back, per second.
_FADE = KinematicLimits(1.0, 1.0, 8.0)
_MARGIN = 1.02


class RecordedTrajectory:
    """The motion through recorded samples, from rest at the first to rest at the last.

    Args:
        times_s: Times (k,) of the samples, increasing.
        joints: The joints (k, n) at these times, rad or m.
        limits: The kinematic limits of each joint; a faster recording is slowed down as a whole.
        lower: The lower limits (n,).
        upper: The upper limits (n,).

    Attributes:
        slowdown: The factor, at least 1, by which the motion is slower than the recording.
    """

    def __init__(
        self,
        times_s: Vector,
        joints: Matrix,
        limits: Sequence[KinematicLimits],
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
        else:  # a single pose
            self._law = JointMove([0.0], [0.0], [_FADE])
            return
        self.slowdown = _required_slowdown(self._spline, self._span_s, limits)
        fade = KinematicLimits(1 / self.slowdown, _FADE.acceleration_rad_s2 / self.slowdown**2,
                    _FADE.jerk_rad_s3 / self.slowdown**3)  # fmt: skip
        self._law = JointMove([0.0], [self._span_s], [fade])

    @property
    def start(self) -> Vector:
        """The first position (n,)."""
        return self.state(0.0).position

    @property
    def duration_s(self) -> float:
        """The duration in seconds, including fade-in and fade-out."""
        return self._law.duration_s

    def state(self, time_s: float) -> TrajectoryPoint:
        """Compute position, velocity and acceleration (n,) at a time; at rest after the end."""
        if self._spline is None:
            return TrajectoryPoint.at_rest(self._still)
        law = self._law.state(time_s)
        s, rate, change = (float(x[0]) for x in (law.position, law.velocity, law.acceleration))
        q, slope, bend = (np.asarray(self._spline(s, k)) for k in range(3))
        return TrajectoryPoint(
            np.clip(q, *self._limits), slope * rate, bend * rate**2 + slope * change
        )

    def sample_path(self) -> Matrix:
        """Sample joints (k, n) along the motion, densely enough for collision checks."""
        if self._spline is None:
            return self._still[None, :]
        return thin_path(np.clip(self._spline(_time_grid(self._span_s)), *self._limits))


def _fit_spline(times_s: Vector, joints: Matrix, span_s: float) -> CubicSpline:
    """Fit a spline to the joints (k, n) over the time since the first sample."""
    from scipy.interpolate import CubicSpline  # noqa: PLC0415  # slow to import, rarely needed
    from scipy.ndimage import gaussian_filter1d  # noqa: PLC0415

    grid = _time_grid(span_s)
    even = np.empty((len(grid), joints.shape[1]))
    for column, samples in enumerate(joints.T):
        even[:, column] = np.interp(grid, times_s, samples)
    width = _SMOOTH_S / float(grid[1])
    margin = min(4 * math.ceil(width), len(grid) - 1)
    # Continue the motion point-symmetrically beyond its ends, without a jerk.
    longer = np.pad(even, ((margin, margin), (0, 0)), mode="reflect", reflect_type="odd")
    smooth: Matrix = gaussian_filter1d(longer, width, axis=0)[margin:-margin]
    return CubicSpline(grid, smooth, bc_type="natural")


def _time_grid(span_s: float) -> Vector:
    return np.linspace(0.0, span_s, 2 + int(span_s / _GRID_S))


def _required_slowdown(
    spline: CubicSpline, span_s: float, limits: Sequence[KinematicLimits]
) -> float:
    """Compute the factor by which the recording must be slowed down to stay within the limits."""
    grid = _time_grid(span_s)
    middles = (grid[:-1] + grid[1:]) / 2
    speed, bend, twist = (
        np.abs(np.asarray(spline(np.concatenate([grid, middles]), k))).max(axis=0)
        for k in (1, 2, 3)
    )
    slowdown = 1.0
    for i, limit in enumerate(limits):
        acceleration = bend[i] + speed[i] * _FADE.acceleration_rad_s2
        jerk = twist[i] + 3 * bend[i] * _FADE.acceleration_rad_s2 + speed[i] * _FADE.jerk_rad_s3
        slowdown = max(
            slowdown,
            _MARGIN * speed[i] / limit.speed_rad_s,
            _MARGIN * math.sqrt(acceleration / limit.acceleration_rad_s2),
            _MARGIN * math.cbrt(jerk / limit.jerk_rad_s3),
        )
    return slowdown


Replayed = tuple[Recording, RecordedTrajectory, MotionPlan | None]
"""A recording, the motion along it, and the plan of a way around to its start if one is needed."""


def _parse_file(value: object) -> str:
    return fspath(parse_path(value))


# A hand may push joints a little beyond their limits.
_LIMIT_TOLERANCE_RAD = math.radians(3.0)
# A limp arm whose horns turn by at most a tick in this time lies still; it falls for at most 3 s.
_LIES = StillnessDetector(window_s=0.2, tolerance=math.radians(0.1), least_readings=2)
_MAX_FALL_S = 3.0


def position_at_rest(arm: ArmParts) -> Vector:
    """Return the joints (n,), rad or m, at the start of a motion, once a limp arm lies still.

    During a replay, the arm may touch only those things that it touches at the start. A limp arm,
    such as a simulated one that has just been opened, touches them only after it has come to rest.
    """
    context, start = arm.context, arm.runner.start_position()
    if context.servos.torque.is_on:
        return start
    units = context.units_per_rad()

    def read_horns() -> Iterable[float]:
        return (arm.runner.start_position() / units).tolist()

    still = read_until_at_rest(_LIES, read_horns, context.servos.clock, _MAX_FALL_S)
    return units * still.joints


def _load(
    context: ArmContext, motion: Replay, start: Vector, preflight: PreflightPlanner
) -> tuple[Recording, RecordedTrajectory]:
    """Load a recording, and check the path to its start and along it.

    If only the straight motion to the first pose is blocked, ``preflight`` must plan another one.
    """
    context.require_zeros()
    path = Path(motion.path)
    recording = _of_this_arm(context, read_recording(path), path)
    _check_limits(context, recording, path)
    lower, upper = context.limits()
    limits = context.planner.motion_limits(motion.speed)
    trajectory = RecordedTrajectory(recording.times_s, recording.joints, limits, lower, upper)
    path = trajectory.sample_path()
    try:
        _check_recorded_path(context, start, path)
    except CollisionError as error:
        if _explain_contact(context, error, path) != "beginning":
            raise
        try:
            preflight.plan(_first_motion(context, trajectory, motion.speed))
        except RefusedError:
            raise error from None
    return recording, trajectory


def _first_motion(context: ArmContext, trajectory: RecordedTrajectory, speed: Speed) -> MoveJoints:
    return MoveJoints(context.index.by_name(trajectory.start), speed=speed)


def _check_recorded_path(context: ArmContext, start: Vector, recorded: Matrix) -> None:
    """Check the path of the joints to the start of a recorded path (k, n), and along that path.

    Contacts at ``start`` (n,) may occur again, with the same depth, except with a box in which the
    recording begins, because the box may have been added later.

    Raises:
        RefusedError: The arm would touch something.
    """
    checker, index = context.checked_collision, context.index
    if checker is None:
        return
    first_m = checker.distances([index.body_joints(recorded[0])])[0]
    for pair, gap_m in zip(checker.pairs, first_m.tolist(), strict=True):
        if pair[1] in checker.things and gap_m < 0.0:
            raise CollisionError(pair, -gap_m, 0.0)
    path = np.vstack([context.interpolate_joints(start, recorded[0]), recorded[1:]])
    checker.check_path(
        index.body_joints(path), may_touch_again=True, began_m=context.contacts_began_m()
    )


def _explain_contact(context: ArmContext, error: CollisionError, path: Matrix) -> str:
    """Add a hint if the path (k, n) would be allowed for an arm that rests at one end.

    Contacts at the start of a replay are allowed throughout the path.

    Returns:
        The end: ``beginning`` or ``end``; empty if the path is not allowed from either end.
    """
    for place, lying in (("beginning", path[0]), ("end", path[-1])):
        try:
            _check_recorded_path(context, lying, path)
        except CollisionError:
            continue
        error.command_hint = (
            f"Switch torque off, move the arm by hand to its posture at the {place} of the "
            f"recording, and replay it again: contacts at the start are then allowed."
        )
        return place
    return ""


@dataclass(frozen=True)
class Replay(OwnMotion[ReplayResult]):
    """Motion to the first pose of a recording of this arm, then along the recording.

    Attributes:
        path: The file.
        speed: The speed class, within which the motion is as fast as recorded.
    """

    path: Annotated[Path | str, _parse_file]
    _: KW_ONLY
    speed: Speed = "normal"

    def __str__(self) -> str:
        return f"recording {self.path}"

    def run(
        self, arm: ArmParts, on_progress: OnProgress | None, loaded: Replayed | None = None
    ) -> ReplayResult:
        """Move to the first pose of the recording, then along the recording; see `replay`.

        A recording that was ``loaded`` by `plan` is not read again, and the way to its start is the
        one that was planned.
        """
        context, runner, speed = arm.context, arm.runner, self.speed
        if is_new := loaded is None:
            loaded = (*_load(context, self, position_at_rest(arm), arm.preflight), None)
        recording, trajectory, detour = loaded
        approach_speed = runner.allowed_speed(speed)
        limits = context.planner.motion_limits(approach_speed)
        started_s = context.now_s()

        def approach(start: Vector) -> JointMove:
            _check_recorded_path(context, start, trajectory.sample_path())
            return JointMove(start, trajectory.start, limits)

        reporter = context.progress_reporter(on_progress)
        if detour is not None:
            execute(arm, replace(detour, limp_arm=None), on_progress)
        try:
            runner.run(approach, reporter, approach_speed)
        except CollisionError:  # nothing has moved
            if not is_new:
                raise
            path = trajectory.sample_path()
            _check_recorded_path(context, path[0], path)
            plan_and_execute(arm, _first_motion(context, trajectory, speed), on_progress)
            runner.run(approach, reporter, approach_speed)
        runner.run(lambda _: trajectory, reporter, speed)
        goal = trajectory.state(trajectory.duration_s).position
        with runner.motion():
            measured = settle_at(context, runner.loop, goal, speed)
        return ReplayResult(
            samples=len(recording.times_s),
            duration_s=context.now_s() - started_s,
            slowdown=trajectory.slowdown,
            error_rad=float(np.abs(measured - goal).max()),
            measured_rad=context.index.by_name(measured),
            measured_tip_m=context.planner.tip(measured),
        )

    def plan(
        self, context: ArmContext, start: Vector, preflight: PreflightPlanner
    ) -> tuple[Replayed, MotionPlan]:
        """Load the recording and plan the whole motion from ``start`` (n,); nothing moves.

        Raises:
            IkservoError: The errors of `run`.
        """
        recording, recorded = _load(context, self, start, preflight)
        detour: MotionPlan | None = None
        try:
            _check_recorded_path(context, start, recorded.sample_path())
            limits = context.planner.motion_limits(self.speed)
            first: Trajectory = JointMove(start, recorded.start, limits)
        except CollisionError:  # as in `run`
            detour = preflight.plan(_first_motion(context, recorded, self.speed))
            first = detour.trajectory
        whole = ConcatenatedTrajectory(first, recorded)
        q = sample_states(whole)[0][:, list(context.index.chain)]
        tips_m = context.chain.forward(q)[:, :3, 3]
        plan = MotionPlan(
            start=start,
            goal=recorded.state(recorded.duration_s).position,
            trajectory=whole,
            tip_m=tips_m[-1],
            path_m=float(np.linalg.norm(np.diff(tips_m, axis=0), axis=1).sum()),
            duration_s=whole.duration_s,
            speed=self.speed,
            around="" if detour is None else detour.around,
            names=tuple(context.servos.names),
            units=tuple(each.joint_map.unit for each in context.servos.driven_joints),
        )
        return (recording, recorded, detour), plan

    def end(self, context: ArmContext, start: Vector) -> Vector:
        """Compute the joints (n,) after a replay from ``start`` (n,); nothing moves.

        Raises:
            IkservoError: The errors of `run`.
        """
        poses = PoseLibrary(context.model, context.serial_number)
        preflight = PreflightPlanner(context, PlannedStart(start), poses)
        _, trajectory = _load(context, self, start, preflight)
        return trajectory.state(trajectory.duration_s).position


def replay(
    arm: OpenArm,
    path: Path | str,
    *,
    speed: str = "normal",
    on_progress: OnProgress | None = None,
    wait: bool = True,
) -> ReplayResult | RunningMotion[ReplayResult]:
    """Move to the first pose of a recording of this arm, then along the recording.

    The motion is as fast as recorded if the speed class allows that; otherwise the whole motion is
    slowed down.

    Raises:
        FileFormatError: The file is malformed, or from another arm; the message names the line.
        RefusedError: The path leaves this arm's limits, or something is in the way; nothing moved.
    """
    motion = Replay(path, speed=speed)
    return (
        arm.execute(motion, on_progress)
        if check_flag("wait", wait)
        else arm.start(motion, on_progress)
    )


def load_replay(
    arm: OpenArm, path: Path | str, *, speed: str = "normal"
) -> tuple[Recording, RecordedTrajectory]:
    """Read a recording; return it with the motion that ``replay`` would play. Nothing moves.

    Raises:
        FileFormatError, RefusedError, CalibrationError: The errors of ``replay``; or the arm is on
            another machine.
    """
    motion, own = Replay(fspath(parse_path(path)), speed=speed), require_own_port(arm)
    return _load(own.context, motion, position_at_rest(own), own.preflight)


def _of_this_arm(context: ArmContext, recording: Recording, path: Path) -> Recording:
    """Return a recording with only the joints of an arm; other programs may record more."""
    header, place = recording.header, recording.place(None)
    own = recording_header(context.model, header.period_s)
    if not header.arm:
        missing = [name for name in own.joints if name not in header.joints]
        if missing:
            raise FileFormatError(path, "/joint_states", f"has no {missing[0]}", "every joint")
        columns = [header.joints.index(name) for name in own.joints]
        return replace(recording, header=own, joints=recording.joints[:, columns])
    for what, found, expected in (
        ("arm", header.arm, own.arm),
        ("joints", ", ".join(header.joints), ", ".join(own.joints)),
        ("units", ", ".join(header.units), ", ".join(own.units)),
    ):
        if found != expected:
            raise FileFormatError(path, place, f"has {what} {found}", f"{what} {expected}")
    return recording


def _check_limits(context: ArmContext, recording: Recording, path: Path) -> None:
    """Refuse a recording that leaves the limits by more than the tolerance."""
    for column, driven in enumerate(context.servos.driven_joints):
        joint_map = driven.joint_map
        tolerance = _LIMIT_TOLERANCE_RAD * joint_map.unit_per_horn_rad
        low, high = driven.position_range
        values = recording.joints[:, column]
        beyond = np.flatnonzero((values < low - tolerance) | (values > high + tolerance))
        if len(beyond):
            first = int(beyond[0])
            violation = driven.describe_violation(joint_map.tick(float(values[first])))
            raise RefusedError(
                f"{path}, {recording.place(first)}: {violation}",
                "Nothing moved. Remove the samples that cannot be replayed.",
            )

"""Settling after a motion: measure, correct and integrate until the joints are at their goals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np

from ikservo.arm.context import ArmContext
from ikservo.arm.tick_rounding import SettlingTarget
from ikservo.calibration import format_source
from ikservo.control.loop import ControlCycle, ControlLoop
from ikservo.control.servo_group import ServoGroup
from ikservo.errors import NotSettledError
from ikservo.guard import CommandLimits
from ikservo.kinematics.arrays import Vector
from ikservo.motion import JointMove, KinematicLimits, Trajectory, TrajectoryPoint

__all__ = [
    "GoalIntegrator",
    "Saturation",
    "SaturationReason",
    "SettlingResult",
    "SettlingTrajectory",
    "settle",
    "settle_at",
]


# The goal moves by this share of what is missing each second, and no slower than the second
# number [rad/s at the horn]: what sticks must come loose in good time.
_FRACTION_PER_S = 4.0
_MIN_RAD_S = 8 * math.tau / 4096
# Near its place a joint that has just moved is waited for: one that broke loose still slides.
_NEAR_TICKS = 3
_MIN_WAIT_S = 0.04
# More than sensors flicker.
_NOISE_TICKS = 1


class Saturation(Enum):
    """What keeps the goal of a joint from going on."""

    LOAD = auto()
    """The goal leads the joint by as much as the guard allows of a joint at rest."""
    LIMIT = auto()
    """The goal is at a limit of the joint."""


@dataclass(frozen=True, slots=True)
class SaturationReason:
    """Why the goal of a joint goes no further.

    Attributes:
        kind: What keeps it.
        text: The same for the user, with the limit that binds and where that comes from.
    """

    kind: Saturation
    text: str


class GoalIntegrator:
    """Integrates what a joint is short of into its goal.

    It ends at the tick that is wanted. A joint without load sticks and then leaps by a tick or
    two; when it has gone across, one tick beside is as near as it gets, and it is not turned
    round for that: on the way back it would lose its play and leap again.

    Args:
        fence: What its servo may be told.
        goal: Where the goal is, ticks.
        wanted: Where the joint shall be, ticks; None where it only has to stand still.
        acceleration: How fast the goal's speed may change, ticks/s².

    Attributes:
        goal: Where the goal is, ticks with fraction.
        at: Where the joint was last seen, ticks.
        still_since_s: Since when the joint stands.
    """

    def __init__(
        self, fence: CommandLimits, goal: int, wanted: int | None, acceleration: float
    ) -> None:
        self.fence, self.goal, self.wanted = fence, float(goal), wanted
        low, high = fence.tick_range
        self._low, self._high = min(low, goal), max(high, goal)
        self._acceleration = acceleration
        self._slowest = _MIN_RAD_S / fence.joint_map.horn_rad_per_tick
        self._lead = fence.max_lead_ticks(0.0)
        self.at = self._before = self._anchor = goal if wanted is None else wanted
        self._moved_s, self.still_since_s = -math.inf, 0.0
        self._side, self._crossed = 0, False
        self._rate = 0.0

    @property
    def error_ticks(self) -> int:
        """Return how many ticks the joint is short of where it is wanted, signed."""
        return 0 if self.wanted is None else self.wanted - self.at

    @property
    def arrived(self) -> bool:
        """Return whether the joint is as near as it gets."""
        return self.error_ticks == 0 or (self._crossed and abs(self.error_ticks) <= 1)

    @property
    def saturation_reason(self) -> SaturationReason | None:
        """What keeps the goal from going on; None where nothing does."""
        if self._is_lead_limited():
            return SaturationReason(Saturation.LOAD, "load too high (correction limit reached)")
        end = self._high if self._side > 0 else self._low
        if self.arrived or self._side * (end - self.goal) > 0:
            return None
        limits = self.fence.limits
        upper = self.fence.joint_map.sign * self._side > 0
        limit = limits.upper if upper else limits.lower
        value, source = self.fence.joint_map.format(limit.value), format_source(limit.source)
        return SaturationReason(Saturation.LIMIT, f"at its limit {value} ({source})")

    def goal_at(self, after_s: float) -> float:
        """Return the goal's tick a time after it was last looked at."""
        return min(max(self.goal + self._rate * after_s, self._low), self._high)

    def update(self, tick: int, time_s: float, elapsed_s: float) -> None:
        """Take where the joint is, and choose how fast its goal goes on."""
        self.goal = self.goal_at(elapsed_s)
        self._track_motion(tick, time_s)
        wish = self._desired_speed(time_s)
        most = self._acceleration * elapsed_s
        self._rate = min(max(wish, self._rate - most), self._rate + most) if wish else 0.0

    def _track_motion(self, tick: int, time_s: float) -> None:
        if tick != self.at:
            if tick != self._before:  # back at the tick before it only flickers
                self._moved_s = time_s
            self._before, self.at = self.at, tick
        if abs(tick - self._anchor) > _NOISE_TICKS:
            self._anchor, self.still_since_s = tick, time_s
        side = (self.error_ticks > 0) - (self.error_ticks < 0)
        self._crossed = self._crossed or side * self._side < 0
        self._side = side or self._side

    def _desired_speed(self, time_s: float) -> float:
        """Return how fast the goal should go on, ticks/s, signed."""
        if self.arrived or self._is_lead_limited():
            return 0.0
        if abs(self.error_ticks) <= _NEAR_TICKS and time_s - self._moved_s < _MIN_WAIT_S:
            return 0.0
        return math.copysign(
            max(_FRACTION_PER_S * abs(self.error_ticks), self._slowest), self.error_ticks
        )

    def _is_lead_limited(self) -> bool:
        return not self.arrived and self._side * (self.goal - self.at) >= self._lead


_AT_REST_S = 0.06
_MAX_DURATION_S = 3.0
# A joint is short when it is further off than sensors flicker.
_RESIDUAL_TICKS = 2


class SettlingTrajectory:
    """A course that begins at the arm's goals and ends when all joints have arrived and stand.

    Args:
        fences: What the servos may be told.
        goals: Where their goals are (n,), ticks.
        wanted: Where the joints shall be, ticks; None for one that keeps its goal.
        paces: How fast each may go.
    """

    def __init__(
        self,
        fences: Sequence[CommandLimits],
        goals: Sequence[int],
        wanted: Sequence[int | None],
        paces: Sequence[KinematicLimits],
    ) -> None:
        self._joints = [
            GoalIntegrator(
                fence, goal, tick, pace.acceleration_rad_s2 / fence.joint_map.unit_per_tick
            )
            for fence, goal, tick, pace in zip(fences, goals, wanted, paces, strict=True)
        ]
        self._seen_s = 0.0
        self._end_s = math.inf

    @property
    def duration_s(self) -> float:
        """Return when it ended; infinite while joints are on their way."""
        return self._end_s

    def state(self, time_s: float) -> TrajectoryPoint:
        """Return where goals are (n,) at a time from the last look at the joints on."""
        after_s = max(0.0, min(time_s, self._end_s) - self._seen_s)
        return TrajectoryPoint.at_rest(
            np.array([j.fence.joint_map.position(j.goal_at(after_s)) for j in self._joints])
        )

    def update(self, time_s: float, measured: Vector) -> None:
        """Take where the joints are (n,) at a time; ends the course when they have arrived."""
        for joint, position in zip(self._joints, measured, strict=True):
            tick = joint.fence.joint_map.tick(float(position))
            joint.update(tick, time_s, time_s - self._seen_s)
        self._seen_s = time_s
        settled = all(_has_ended(j) for j in self._joints) and not self.moving_joints
        if settled or time_s >= _MAX_DURATION_S:
            self._end_s = min(self._end_s, time_s)

    @property
    def moving_joints(self) -> tuple[str, ...]:
        """Return the joints that have moved just now."""
        since_s = self._seen_s - _AT_REST_S
        return tuple(j.fence.joint for j in self._joints if j.still_since_s > since_s)

    @property
    def measured(self) -> Vector:
        """Return where the joints were last seen (n,), rad or m."""
        return np.array([j.fence.joint_map.position(j.at) for j in self._joints])

    @property
    def saturated(self) -> tuple[str, ...]:
        """Return the joints that did not arrive and whose goals go no further."""
        short = (j for j in self._joints if abs(j.error_ticks) >= _RESIDUAL_TICKS)
        return tuple(j.fence.joint for j in short if j.saturation_reason is not None)

    @property
    def residuals(self) -> tuple[str, ...]:
        """Return which joints did not arrive, by how much and why, in words."""
        return tuple(
            _describe_residual(j) for j in self._joints if abs(j.error_ticks) >= _RESIDUAL_TICKS
        )


def _has_ended(joint: GoalIntegrator) -> bool:
    return joint.arrived or joint.saturation_reason is not None


def _describe_residual(joint: GoalIntegrator) -> str:
    reason = joint.saturation_reason
    joint_map = joint.fence.joint_map
    missing = joint_map.format(abs(joint.error_ticks) * joint_map.unit_per_tick)
    return f"{joint_map.joint} is {missing} short: {reason.text if reason else 'timeout'}"


@dataclass(frozen=True, slots=True, eq=False)
class SettlingResult:
    """Where a motion ended.

    Attributes:
        measured: Where the joints are (n,), rad or m.
        residuals: Which joints did not arrive, by how much and why, in words.
        motion_s: How long the motion took up to its planned end.
        settling_s: How long it took from there until all joints stood where they belong.
    """

    measured: Vector
    residuals: tuple[str, ...]
    motion_s: float
    settling_s: float

    @property
    def duration_s(self) -> float:
        """Return the time from the first goal to rest."""
        return self.motion_s + self.settling_s


def settle(
    stream: ControlLoop,
    servos: ServoGroup,
    aim: SettlingTarget,
    paces: Sequence[KinematicLimits],
    speed_rad_s: float,
    motion_s: float,
    below: Vector | None = None,
) -> SettlingResult:
    """Lead the goals until the joints stand where they are wanted, as near as they can.

    Where a joint can go no further the others make up for it, once.

    Args:
        stream: The way to the servos.
        servos: The arm, at the end of its motion.
        aim: Where the joints belong.
        paces: How fast each may go.
        speed_rad_s: The motion's top speed at the horns.
        motion_s: How long the motion took up to here.
        below: Goals (n,) to which joints with known play go first, see ``backlash_approach``.

    Raises:
        NotSettledError: Some joint still moves after three seconds.
        StoppedError, RefusedError, BusError, ServoAlarmError: See ``ControlLoop.run``.
    """
    started_s = servos.clock.now_s()
    if below is not None:
        stream.run(JointMove(servos.goals(), below, paces), speed_rad_s=speed_rad_s)
    first = last = _run_settling(stream, servos, aim.ticks, paces, speed_rad_s)
    instead = aim.retarget_without(first.saturated, first.measured) if first.saturated else None
    if instead is not None:
        last = _run_settling(stream, servos, instead, paces, speed_rad_s)
    settling_s = servos.clock.now_s() - started_s
    short = tuple(dict.fromkeys(first.residuals + last.residuals))
    return SettlingResult(last.measured, short, motion_s, settling_s)


def _run_settling(
    stream: ControlLoop,
    servos: ServoGroup,
    wanted: Sequence[int | None],
    paces: Sequence[KinematicLimits],
    speed_rad_s: float,
) -> SettlingTrajectory:
    goals = [f.tick(float(goal)) for f, goal in zip(servos.fences, servos.goals(), strict=True)]
    course = SettlingTrajectory(servos.fences, goals, wanted, paces)

    def look(beat: ControlCycle) -> None:
        course.update(beat.time_s, beat.measured)

    stream.run(course, look, speed_rad_s=speed_rad_s)
    if course.moving_joints:
        names = ", ".join(course.moving_joints)
        raise NotSettledError(
            f"{names} did not settle in time.", "Check for a loose horn or a changing load."
        )
    return course


def settle_at(arm: ArmContext, goal: Vector, speed: str) -> Vector:
    """Lead the arm's goals until its joints stand at ``goal`` (n,), as near as they can.

    A gripper keeps its goal: it may hold something.

    Args:
        arm: At rest, its goals near there.
        goal: Where the joints belong, rad or m.
        speed: slow, normal or fast.

    Returns:
        Where they were at the last beat (n,).
    """
    fences, corrections = arm.servos.fences, list[SettlingTrajectory]()
    joints = zip(fences, goal.tolist(), strict=True)
    wanted = [f.tick(at) if f.joint in arm.chain.names else None for f, at in joints]

    def begin(here: Vector) -> Trajectory:
        goals = [f.tick(at) for f, at in zip(fences, here.tolist(), strict=True)]
        corrections.append(
            SettlingTrajectory(fences, goals, wanted, arm.planner.motion_limits(speed))
        )
        return corrections[0]

    def look(beat: ControlCycle) -> None:
        corrections[0].update(beat.time_s, beat.measured)

    return arm.drive(begin, look, speed)

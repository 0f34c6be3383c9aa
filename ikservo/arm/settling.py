"""Settling after a motion: measure, correct and integrate until the joints are at their goals."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import Enum, auto

import numpy as np

from ikservo.arm.context import ArmContext
from ikservo.arm.motion_runner import MotionRunner
from ikservo.arm.tick_rounding import SettlingTarget, chain_ticks
from ikservo.calibration import format_source
from ikservo.control.loop import ControlCycle, ControlLoop
from ikservo.control.servo_group import ServoGroup
from ikservo.guard import CommandLimits
from ikservo.kinematics.arrays import Vector, freeze_arrays
from ikservo.motion import JointMove, KinematicLimits, TrajectoryPoint

__all__ = [
    "GoalIntegrator",
    "Saturation",
    "SaturationReason",
    "SettlingResult",
    "SettlingTrajectory",
    "settle",
    "settle_at",
]


# The goal moves by this fraction of the error each second, and no slower than the second number
# [rad/s at the horn]: stiction must be overcome in good time.
_FRACTION_PER_S = 4.0
_MIN_RAD_S = 16 * math.tau / 4096
# A joint that friction keeps does not move with its goal, however slow its speed class is.
_MIN_RAD_S2 = 4.0
# A servo may have less friction than known, by this share of both its directions together.
_FRICTION_MARGIN = 0.15
# While it jumps its goal goes back by so much of its speed, over this time, and no further: a joint
# that swings fast would make it leap.
_BRAKE_S, _BRAKE_FILTER_S, _MAX_BRAKE_TICKS = 0.05, 0.02, 4.0
# A joint that turns round so often, by more than stiction and noise explain, swings in the play of
# its gears. Correcting would feed the swing, so its goal stays. Once at rest it is corrected
# again, so many times.
_SWING_TICKS, _MAX_TURNS, _MAX_RESTS = 4.5, 4, 2
# One that swings for so long with its goal at rest is left swinging.
_MAX_SWING_S = 1.0
# Near its target a joint that has just moved is waited for: after stiction it still slides.
_NEAR_TICKS = 3
_MIN_WAIT_S = 0.04
_AT_REST_S = 0.06
# Sensor noise is within this.
_NOISE_TICKS = 1


class Saturation(Enum):
    """What limits the correction of a joint."""

    LOAD = auto()
    """The goal leads the joint by as much as the guard allows for a joint at rest."""
    LIMIT = auto()
    """The goal is at a limit of the joint."""


@dataclass(frozen=True, slots=True)
class SaturationReason:
    """Why the goal of a joint goes no further.

    Attributes:
        kind: What limits it.
        text: The same for the user, with the limit that binds and its source.
    """

    kind: Saturation
    text: str


class GoalIntegrator:
    """Integrates the error of a joint into its goal.

    It ends at the target tick. A joint without load sticks and then jumps by a tick or two; when
    it has crossed the target, or is pressed away from it, one tick beside is as near as it gets,
    and it is not reversed for that: on the way back it would cross its backlash and jump further.
    Each time that it jumps over the target again, twice as many ticks beside it are enough. While
    it moves its goal goes back, against its speed, so that the jump is short. The goal of a joint
    that swings stays.

    Args:
        fence: The limits of its servo's commands.
        goal: The goal, ticks.
        target: Where the joint should be, ticks; None where it only has to come to rest.
        acceleration: How fast the goal's speed may change, ticks/s².
        stuck: Between which leads over the joint friction is expected to keep it, ticks: through
            them the goal goes fast. Twice the same number where that is not known.

    Attributes:
        goal: The goal of a joint at rest, ticks with fraction.
        at: The last measured position, ticks.
        still_since_s: Since when the joint is within sensor noise of where it was.
        moved_s: When the position last changed, other than back by noise.
        swing_ticks: How far the joint went between the last two times that it turned round.
    """

    def __init__(
        self,
        fence: CommandLimits,
        goal: int,
        target: int | None,
        acceleration: float,
        stuck: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.fence, self.goal, self.target = fence, float(goal), target
        low, high = fence.tick_range
        self._low, self._high = min(low, goal), max(high, goal)
        self._acceleration, self._stuck = acceleration, stuck
        self._slowest = _MIN_RAD_S / fence.joint_map.horn_rad_per_tick
        self._lead = fence.max_lead_ticks(0.0)
        self.at = self._before = self._anchor = goal if target is None else target
        self.moved_s, self.still_since_s = -math.inf, 0.0
        self._side, self._furthest, self._enough = 0, 0, 0
        self._rate = self._brake = 0.0
        self._filtered: float | None = None
        self._turn = self._extreme = self.at
        self._heading = self._turns = self._rests = 0
        self._swings_since_s = math.inf
        self.swing_ticks = 0

    @property
    def error_ticks(self) -> int:
        """Return the error of the joint in ticks, signed."""
        return 0 if self.target is None else self.target - self.at

    @property
    def arrived(self) -> bool:
        """Return whether the joint is as near to its target as it gets."""
        beside = abs(self.error_ticks)
        return beside <= self._enough or (beside == 1 and self._would_cross_backlash())

    @property
    def swings(self) -> bool:
        """Whether the joint swings, or has done so too often, and keeps its goal."""
        return self._turns >= _MAX_TURNS

    def has_swung_at(self, time_s: float) -> bool:
        """Return whether the joint has swung for so long that it is left swinging."""
        return time_s - self._swings_since_s >= _MAX_SWING_S

    @property
    def saturation_reason(self) -> SaturationReason | None:
        """Why the goal goes no further; None where it does."""
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

    def moves_at(self, time_s: float) -> bool:
        """Return whether the joint is not at rest at the time of the last update.

        One that friction has just let go may be no further than noise so far.
        """
        return self.still_since_s > time_s - _AT_REST_S or self.moved_s > time_s - _MIN_WAIT_S

    def goal_at(self, after_s: float) -> float:
        """Return the goal's tick a time after the last update."""
        return self._inside(self.goal + self._rate * after_s - self._brake)

    def update(
        self, tick: int, time_s: float, elapsed_s: float, *, correcting: bool = True
    ) -> None:
        """Take the measured position, and choose the speed of the goal; 0 where not correcting."""
        self.goal = self._inside(self.goal + self._rate * elapsed_s)
        self._track_motion(tick, time_s)
        self._track_swings(tick, time_s)
        self._track_speed(tick, elapsed_s)
        speed = self._desired_speed(time_s) if correcting else 0.0
        change = self._acceleration * elapsed_s
        self._rate = min(max(speed, self._rate - change), self._rate + change) if speed else 0.0

    def _track_motion(self, tick: int, time_s: float) -> None:
        if tick != self.at:
            if tick != self._before:  # back at the tick before is noise
                self.moved_s = time_s
            self._before, self.at = self.at, tick
        if abs(tick - self._anchor) > _NOISE_TICKS:
            self._anchor, self.still_since_s = tick, time_s
        side = (self.error_ticks > 0) - (self.error_ticks < 0)
        if side * self._side < 0:
            if self._furthest > self._enough:
                self._enough = 2 * self._enough or 1
            self._furthest = 0
        self._furthest = max(self._furthest, abs(self.error_ticks))
        self._side = side or self._side

    def _track_swings(self, tick: int, time_s: float) -> None:
        """Count how often the joint turns round by more than stiction and noise explain."""
        if self._heading * (tick - self._extreme) > 0:
            self._extreme = tick
        elif abs(tick - self._extreme) > _SWING_TICKS:
            self._turns += bool(self._heading)
            self.swing_ticks = abs(self._extreme - self._turn)
            self._turn, self._extreme = self._extreme, tick
            self._heading = 1 if tick > self._turn else -1
        if not self.swings:
            self._swings_since_s = math.inf
        elif self._swings_since_s == math.inf:
            self._swings_since_s = time_s
        elif not self.moves_at(time_s) and self._rests < _MAX_RESTS:
            self._rests += 1
            self._turns, self._turn = 0, tick

    def _track_speed(self, tick: int, elapsed_s: float) -> None:
        """Brake by the speed of the filtered position; not a joint that keeps its goal."""
        filtered = tick if self._filtered is None or self.target is None else self._filtered
        self._filtered = filtered + min(elapsed_s / _BRAKE_FILTER_S, 1.0) * (tick - filtered)
        brake = _BRAKE_S / _BRAKE_FILTER_S * (tick - self._filtered)
        if self.swings or abs(brake) < 1.0:  # or goals move when all are at rest
            brake = 0.0
        self._brake = min(max(brake, -_MAX_BRAKE_TICKS), _MAX_BRAKE_TICKS)

    def _inside(self, goal: float) -> float:
        return min(max(goal, self._low), self._high)

    def _desired_speed(self, time_s: float) -> float:
        """Return the desired speed of the goal, ticks/s, signed."""
        if self.arrived or self.swings or self._is_lead_limited():
            return 0.0
        if abs(self.error_ticks) <= _NEAR_TICKS and time_s - self.moved_s < _MIN_WAIT_S:
            return 0.0
        slowly = max(_FRACTION_PER_S * abs(self.error_ticks), self._slowest)
        return math.copysign(max(slowly, self._speed_while_stuck()), self.error_ticks)

    def _would_cross_backlash(self) -> bool:
        """Return whether gears without load have to change their flank on the way to the target."""
        low, high = self._stuck
        return low < 0.0 < high and self._side * (self.goal - self.at) < 0.0

    def _speed_while_stuck(self) -> float:
        """Return the speed with which the goal comes to rest before friction lets the joint go."""
        low, high = self._stuck
        lead = self._side * (self.goal - self.at)
        end = max(self._side * low, self._side * high) - _FRICTION_MARGIN * (high - low)
        return math.sqrt(2.0 * self._acceleration * max(end - lead, 0.0))

    def _is_lead_limited(self) -> bool:
        return not self.arrived and self._side * (self.goal - self.at) >= self._lead


def _never(_measured: Vector) -> bool:
    return False


_MAX_DURATION_S = 3.0
# A joint that friction lets go just before that comes to rest at its goal within this time.
_MAX_COAST_S = 0.5
# A swing further than this, at the horn, is more than worn gears explain: something is loose.
_MAX_PLAY_SWING_RAD = math.radians(4.0)
# An error is reported where it exceeds sensor noise.
_RESIDUAL_TICKS = 2


class SettlingTrajectory:
    """A trajectory from the arm's goals that ends when all joints have arrived and are at rest.

    Args:
        fences: The limits of the servos' commands.
        goals: Their goals (n,), ticks.
        targets: Where the joints should be, ticks; None for one that keeps its goal.
        limits: The kinematic limits of each.
        stuck: The lowest and the highest leads of goals (n,) with which friction keeps the joints.
        is_reached: Whether the arm is where it should be with its joints as measured (n,), though
            not each joint is: goals then stay, and it ends when all joints are at rest.
    """

    def __init__(
        self,
        fences: Sequence[CommandLimits],
        goals: Sequence[int],
        targets: Sequence[int | None],
        limits: Sequence[KinematicLimits],
        stuck: tuple[Vector, Vector] | None = None,
        is_reached: Callable[[Vector], bool] = _never,
    ) -> None:
        low, high = stuck or (np.zeros(len(fences)), np.zeros(len(fences)))
        rows = zip(fences, goals, targets, limits, low, high, strict=True)
        self._joints = [
            GoalIntegrator(
                fence,
                goal,
                target,
                _goal_acceleration(fence, limit),
                _lead_ticks(fence, float(lowest), float(highest)),
            )
            for fence, goal, target, limit, lowest, highest in rows
        ]
        self._is_reached, self._reached = is_reached, False
        self._updated_s = 0.0
        self._end_s = math.inf

    @property
    def duration_s(self) -> float:
        """Return when it ended; infinite until all joints have settled."""
        return self._end_s

    def state(self, time_s: float) -> TrajectoryPoint:
        """Return the goals (n,) at a time since the last update."""
        after_s = max(0.0, min(time_s, self._end_s) - self._updated_s)
        return TrajectoryPoint.at_rest(
            np.array([j.fence.joint_map.position(j.goal_at(after_s)) for j in self._joints])
        )

    def update(self, time_s: float, measured: Vector, *, end: bool = False) -> None:
        """Take the measured joints (n,); ends the trajectory when they have arrived.

        Args:
            time_s: The time.
            measured: The joints.
            end: Correct no further, and end as soon as the joints are at rest.
        """
        self._reached = self._is_reached(measured)
        correcting = time_s < _MAX_DURATION_S and not (self._reached or end)
        for joint, position in zip(self._joints, measured, strict=True):
            tick = joint.fence.joint_map.tick(float(position))
            joint.update(tick, time_s, time_s - self._updated_s, correcting=correcting)
        self._updated_s = time_s
        ended = not correcting or all(_has_ended(j) for j in self._joints)
        rests = all(j.has_swung_at(time_s) or not j.moves_at(time_s) for j in self._joints)
        if (ended and rests) or time_s >= _MAX_DURATION_S + _MAX_COAST_S:
            self._end_s = min(self._end_s, time_s)

    @property
    def moving_joints(self) -> tuple[str, ...]:
        """Return the joints that are not at rest."""
        return tuple(j.fence.joint for j in self._joints if j.moves_at(self._updated_s))

    @property
    def unsettled_joints(self) -> tuple[str, ...]:
        """Return the joints that move by more than the play of gears explains."""
        return tuple(j.fence.joint for j in self._joints if not _is_trusted(j, self._updated_s))

    @property
    def measured(self) -> Vector:
        """Return the last measured joints (n,), rad or m."""
        return np.array([j.fence.joint_map.position(j.at) for j in self._joints])

    @property
    def saturated(self) -> tuple[str, ...]:
        """Return the joints that did not arrive and whose goals go no further."""
        return tuple(j.fence.joint for j in self._missed if j.saturation_reason is not None)

    @property
    def residuals(self) -> tuple[str, ...]:
        """Describe the joints that did not arrive, by how much and why."""
        return tuple(_describe_residual(j, self._updated_s) for j in self._missed)

    @property
    def _missed(self) -> list[GoalIntegrator]:
        if self._reached:
            return []
        return [
            j
            for j in self._joints
            if abs(j.error_ticks) >= _RESIDUAL_TICKS or (j.swings and j.moves_at(self._updated_s))
        ]


def _goal_acceleration(fence: CommandLimits, limits: KinematicLimits) -> float:
    """Return how fast the speed of a joint's goal changes, ticks/s²."""
    usual = limits.acceleration_rad_s2 / fence.joint_map.unit_per_tick
    return max(usual, _MIN_RAD_S2 / fence.joint_map.horn_rad_per_tick)


def _lead_ticks(fence: CommandLimits, lowest: float, highest: float) -> tuple[float, float]:
    """Return two leads of a goal, rad or m, in ticks, the lower one first."""
    per_unit = fence.joint_map.sign / fence.joint_map.unit_per_tick
    low, high = sorted((lowest * per_unit, highest * per_unit))
    return low, high


def _has_ended(joint: GoalIntegrator) -> bool:
    return joint.arrived or joint.swings or joint.saturation_reason is not None


def _is_trusted(joint: GoalIntegrator, time_s: float) -> bool:
    """Return whether a joint rests, or swings no further than the play of its gears explains."""
    swing_rad = joint.swing_ticks * joint.fence.joint_map.horn_rad_per_tick
    return not joint.moves_at(time_s) or (joint.swings and swing_rad <= _MAX_PLAY_SWING_RAD)


def _describe_residual(joint: GoalIntegrator, time_s: float) -> str:
    reason, joint_map = joint.saturation_reason, joint.fence.joint_map
    missing = joint_map.format(abs(joint.error_ticks) * joint_map.unit_per_tick)
    if not joint.swings:
        return f"{joint_map.joint} is {missing} short: {reason.text if reason else 'timeout'}"
    swing = joint_map.format(joint.swing_ticks * joint_map.unit_per_tick)
    verb = "swings" if joint.moves_at(time_s) else "swung"
    return f"{joint_map.joint} {verb} by {swing} and is {missing} off: no load presses its gears"


@dataclass(frozen=True, slots=True, eq=False)
class SettlingResult:
    """Where a motion ended.

    Attributes:
        measured: The joints (n,), rad or m.
        residuals: The joints that did not arrive, by how much and why.
        motion_s: How long the motion took up to its planned end.
        settling_s: How long settling took after that.
        unsettled: The joints that still move by more than the play of gears explains.
    """

    measured: Vector
    residuals: tuple[str, ...]
    motion_s: float
    settling_s: float
    unsettled: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        freeze_arrays(self)

    @property
    def duration_s(self) -> float:
        """Return the time from the first goal to rest."""
        return self.motion_s + self.settling_s


def settle(
    loop: ControlLoop,
    servos: ServoGroup,
    target: SettlingTarget,
    limits: Sequence[KinematicLimits],
    speed_rad_s: float,
    motion_s: float,
    below: Vector | None = None,
) -> SettlingResult:
    """Correct the goals until the joints are at their target, as near as they can.

    Where a joint can go no further the others compensate for it, once.

    Args:
        loop: Streams to the servos.
        servos: The servos, at the end of a motion.
        target: The ticks at which the joints should be.
        limits: The kinematic limits of each joint.
        speed_rad_s: The motion's top speed at the horns.
        motion_s: How long the motion took.
        below: Goals (n,) to which joints with known backlash go first, see ``backlash_approach``.

    Raises:
        StoppedError, RefusedError, BusError, ServoAlarmError: See ``ControlLoop.run``.
    """
    started_s = servos.clock.now_s()
    if below is not None:
        approach = JointMove(servos.goals(), below, limits)
        loop.run(approach, speed_rad_s=speed_rad_s, compensated=False)
    first = last = _run_settling(loop, servos, target.ticks, limits, speed_rad_s, target.is_reached)
    instead = target.retarget_without(first.saturated, first.measured) if first.saturated else None
    if instead is not None and not first.unsettled_joints:
        last = _run_settling(loop, servos, instead, limits, speed_rad_s, target.is_reached)
    settling_s = servos.clock.now_s() - started_s
    residuals = tuple(dict.fromkeys(first.residuals + last.residuals))
    return SettlingResult(last.measured, residuals, motion_s, settling_s, last.unsettled_joints)


def settle_at(
    context: ArmContext,
    runner: MotionRunner,
    goal: Vector,
    speed: str,
    is_over: Callable[[ControlCycle], bool] | None = None,
    *,
    by_tip: bool = False,
) -> Vector:
    """Correct the arm's goals until its joints are at ``goal`` (n,), as near as they can.

    A gripper keeps its goal: it may hold something.

    Args:
        context: The arm.
        runner: Runs the correction as a motion; the goals are near there.
        goal: The positions of the joints, rad or m.
        speed: slow, normal or fast.
        is_over: Called in each control cycle; returns whether to end as soon as the joints rest.
        by_tip: Whether the ticks nearest to the tip at ``goal`` are wanted, as after a motion to a
            point; else those nearest to each joint's position.

    Returns:
        The measured joints (n,) of the last control cycle.
    """
    ticks = chain_ticks(context.chain, context.index, context.servos.fences, goal, by_tip=by_tip)
    limits, horn_rad_s = context.planner.motion_limits(speed), context.model.speed(speed).rad_s
    with runner.motion():
        return _run_settling(
            runner.loop, context.servos, ticks, limits, horn_rad_s, is_over=is_over
        ).measured


def _run_settling(
    loop: ControlLoop,
    servos: ServoGroup,
    ticks: Sequence[int | None],
    limits: Sequence[KinematicLimits],
    speed_rad_s: float,
    is_reached: Callable[[Vector], bool] = _never,
    is_over: Callable[[ControlCycle], bool] | None = None,
) -> SettlingTrajectory:
    goals = [f.tick(float(goal)) for f, goal in zip(servos.fences, servos.goals(), strict=True)]
    stuck = servos.compensator.stuck_offsets(servos.reference())
    trajectory = SettlingTrajectory(servos.fences, goals, ticks, limits, stuck, is_reached)

    def update(cycle: ControlCycle) -> None:
        over = is_over is not None and is_over(cycle)
        trajectory.update(cycle.time_s, cycle.measured, end=over)

    loop.run(trajectory, update, speed_rad_s=speed_rad_s, compensated=False)
    servos.set_reference(trajectory.measured)
    return trajectory

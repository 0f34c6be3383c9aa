"""Settling after a motion: measure and correct until the joints are at their goals."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from ikservo.control.loop import ControlCycle, ControlLoop
from ikservo.control.servo_group import ServoGroup
from ikservo.guard import DrivenJoint
from ikservo.kinematics.arrays import FrozenArrays, Vector
from ikservo.motion import JointMove, KinematicLimits, TrajectoryPoint
from ikservo.planning.context import ArmContext
from ikservo.settling.goal_integrator import GoalIntegrator
from ikservo.settling.tick_rounding import SettlingTarget, chain_ticks


def _never(_measured: Vector) -> bool:
    return False


# A joint held by friction does not move with its goal, however slow its speed class is.
_MIN_RAD_S2 = 4.0
_MAX_DURATION_S = 5.0
# A joint that friction releases just before that comes to rest at its goal within this time.
_MAX_COAST_S = 0.5
# A swing started by a last correction comes to rest within this time.
_MAX_SWING_S = 2.5
# A swing larger than this, at the horn, is more than worn gears explain: something is loose.
_MAX_PLAY_SWING_RAD = math.radians(4.0)
# An error is reported if it exceeds sensor noise.
_RESIDUAL_TICKS = 2


class SettlingTrajectory:
    """A trajectory from the arm's goals that ends when all joints have arrived and are at rest.

    Args:
        driven_joints: The joints, each with its servo, limits and speed.
        goals: The joint goals (n,), ticks.
        targets: The targets of the joints, ticks; None for a joint that keeps its goal.
        limits: The kinematic limits of each joint.
        stuck: The lowest and highest leads of goals (n,) at which friction keeps the joints still.
        is_reached: Returns whether the tool is at its target at the measured joints (n,), even if
            not every joint is at its own target; goals then stay, and the trajectory ends at rest.
    """

    def __init__(
        self,
        driven_joints: Sequence[DrivenJoint],
        goals: Sequence[int],
        targets: Sequence[int | None],
        limits: Sequence[KinematicLimits],
        stuck: tuple[Vector, Vector] | None = None,
        is_reached: Callable[[Vector], bool] = _never,
    ) -> None:
        leads = np.zeros((2, len(driven_joints))) if stuck is None else np.array(stuck)
        rows = zip(driven_joints, goals, targets, limits, leads.T.tolist(), strict=True)
        self._joints: list[GoalIntegrator] = []
        for driven, goal, target, limit, (lowest, highest) in rows:
            joint_map = driven.joint_map
            usual = limit.acceleration_rad_s2 / joint_map.unit_per_tick
            acceleration = max(usual, _MIN_RAD_S2 / joint_map.horn_rad_per_tick)
            per_unit = joint_map.sign / joint_map.unit_per_tick
            low, high = sorted((lowest * per_unit, highest * per_unit))
            joint = GoalIntegrator(driven, goal, target, acceleration, (low, high))
            self._joints.append(joint)
        self._is_reached, self._reached = is_reached, False
        self._updated_s = 0.0
        self._end_s = math.inf

    @property
    def duration_s(self) -> float:
        """The time at which settling ended; infinite until all joints have settled."""
        return self._end_s

    def state(self, time_s: float) -> TrajectoryPoint:
        """Compute the goals (n,) at a time since the last update."""
        after_s = max(0.0, min(time_s, self._end_s) - self._updated_s)
        return TrajectoryPoint.at_rest(
            np.array([j.driven.joint_map.position(j.goal_at(after_s)) for j in self._joints])
        )

    def update(self, time_s: float, measured: Vector, *, end: bool = False) -> None:
        """Process the measured joints (n,); end the trajectory when they have arrived.

        Args:
            time_s: The time.
            measured: The joints.
            end: Whether to stop correcting and end as soon as the joints are at rest.
        """
        self._reached = self._is_reached(measured)
        correcting = time_s < _MAX_DURATION_S and not (self._reached or end)
        for joint, position in zip(self._joints, measured, strict=True):
            tick = joint.driven.joint_map.tick(float(position))
            joint.update(tick, time_s, time_s - self._updated_s, correcting=correcting)
        self._updated_s = time_s
        ended = not correcting or all(
            j.arrived or j.swings or j.saturation_reason is not None for j in self._joints
        )
        rests = all(j.has_swung_at(time_s) or not j.moves_at(time_s) for j in self._joints)
        swung = any(j.has_swung for j in self._joints)
        most_s = _MAX_DURATION_S + (_MAX_SWING_S if swung else _MAX_COAST_S)
        if (ended and rests) or time_s >= most_s:
            self._end_s = min(self._end_s, time_s)

    @property
    def moving_joints(self) -> tuple[str, ...]:
        """The joints that are not at rest."""
        return tuple(j.driven.joint for j in self._joints if j.moves_at(self._updated_s))

    @property
    def unsettled_joints(self) -> tuple[str, ...]:
        """The joints that move by more than their backlash allows."""
        unsettled: list[str] = []
        for joint in self._joints:
            swing_rad = joint.swing_ticks * joint.driven.joint_map.horn_rad_per_tick
            is_explained = joint.has_swung and swing_rad <= _MAX_PLAY_SWING_RAD
            if joint.moves_at(self._updated_s) and not is_explained:
                unsettled.append(joint.driven.joint)
        return tuple(unsettled)

    @property
    def measured(self) -> Vector:
        """The last measured joints (n,), rad or m."""
        return np.array([j.driven.joint_map.position(j.at) for j in self._joints])

    @property
    def saturated(self) -> tuple[str, ...]:
        """The joints that did not arrive and whose goals cannot move further."""
        return tuple(j.driven.joint for j in self._missed if j.saturation_reason is not None)

    @property
    def residuals(self) -> tuple[str, ...]:
        """Descriptions of the joints that did not arrive, with distance and reason."""
        return tuple(_describe_residual(j, self._updated_s) for j in self._missed)

    @property
    def _missed(self) -> list[GoalIntegrator]:
        if self._reached:
            return []
        return [
            j
            for j in self._joints
            if abs(j.error_ticks) >= _RESIDUAL_TICKS or _still_swings(j, self._updated_s)
        ]


def _still_swings(joint: GoalIntegrator, time_s: float) -> bool:
    return joint.has_swung and joint.moves_at(time_s)


def _describe_residual(joint: GoalIntegrator, time_s: float) -> str:
    reason, joint_map = joint.saturation_reason, joint.driven.joint_map
    missing = joint_map.format(abs(joint.error_ticks) * joint_map.unit_per_tick)
    if not (joint.swings or _still_swings(joint, time_s)):
        why = (
            reason.text
            if reason
            else "its friction would make it overshoot"
            if joint.arrived
            else "timeout"
        )
        return f"{joint_map.joint} is {missing} short: {why}"
    swing = joint_map.format(joint.swing_ticks * joint_map.unit_per_tick)
    verb = "swings" if joint.moves_at(time_s) else "swung"
    return (
        f"{joint_map.joint} {verb} by {swing} and is {missing} off, because no load presses its "
        f"gears together"
    )


@dataclass(frozen=True, slots=True, eq=False)
class SettlingResult(FrozenArrays):
    """The result of settling at the end of a motion.

    Attributes:
        measured: The joints (n,), rad or m.
        residuals: The joints that did not arrive, with distance and reason.
        motion_s: The duration of the motion up to its planned end, including the preload.
        settling_s: The duration of settling after that.
        unsettled: The joints that still move by more than their backlash allows.
    """

    measured: Vector
    residuals: tuple[str, ...]
    motion_s: float
    settling_s: float
    unsettled: tuple[str, ...] = ()

    @property
    def duration_s(self) -> float:
        """The time from the first goal to rest."""
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
    """Correct the goals until the joints are at their target, or as close as possible.

    If a joint cannot move further, the other joints compensate for this once.

    Args:
        loop: Streams to the servos.
        servos: The servos, at the end of a motion.
        target: The target ticks of the joints.
        limits: The kinematic limits of each joint.
        speed_rad_s: The motion's top speed at the horns.
        motion_s: The duration of the motion.
        below: Goals (n,) to which joints with known backlash move first; see ``approach_goals``.

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
    loop: ControlLoop,
    goal: Vector,
    speed: str,
    is_over: Callable[[ControlCycle], bool] | None = None,
    *,
    by_tip: bool = False,
) -> Vector:
    """Correct the arm's goals until its joints are at ``goal`` (n,), or as close as possible.

    A gripper keeps its goal, because it may hold something.

    Args:
        context: The arm.
        loop: Runs the correction as a part of a motion whose goals are near ``goal``.
        goal: The joint positions, rad or m.
        speed: slow, normal or fast.
        is_over: Called in each control cycle; returns whether to end as soon as the joints rest.
        by_tip: Whether to use the ticks that bring the tip closest to its position at ``goal``, as
            after a motion to a point; otherwise, the ticks closest to each joint's position.

    Returns:
        The measured joints (n,) of the last control cycle.
    """
    ticks = chain_ticks(
        context.chain, context.index, context.servos.driven_joints, goal, by_tip=by_tip
    )
    limits, horn_rad_s = context.planner.motion_limits(speed), context.model.speed(speed).rad_s
    return _run_settling(loop, context.servos, ticks, limits, horn_rad_s, is_over=is_over).measured


def lift_to_start(context: ArmContext, loop: ControlLoop, start: Vector, horn_rad_s: float) -> None:
    """Bring a sagged arm back to ``start`` (n,), where the tip will start to follow a path.

    A limp arm sags when its torque is switched on, although its goals are at ``start``. A joint
    motion may begin by lifting the arm, but a line would begin off its path.

    Args:
        context: The arm, in a motion.
        loop: Runs that motion.
        start: The joints that the servos hold, rad or m.
        horn_rad_s: The motion's top speed at the horns.
    """
    servos, columns = context.servos, list(context.index.chain)
    tick = np.array([driven.joint_map.unit_per_tick for driven in servos.driven_joints])
    sag_ticks = np.abs(servos.measure_positions() - start) / tick
    if (sag_ticks[columns] <= _RESIDUAL_TICKS).all():
        return
    ticks = chain_ticks(context.chain, context.index, servos.driven_joints, start, by_tip=True)
    limits = context.planner.motion_limits("slow")
    _run_settling(loop, servos, ticks, limits, horn_rad_s)


def _run_settling(
    loop: ControlLoop,
    servos: ServoGroup,
    ticks: Sequence[int | None],
    limits: Sequence[KinematicLimits],
    speed_rad_s: float,
    is_reached: Callable[[Vector], bool] = _never,
    is_over: Callable[[ControlCycle], bool] | None = None,
) -> SettlingTrajectory:
    goals = [
        driven.tick(float(goal))
        for driven, goal in zip(servos.driven_joints, servos.goals(), strict=True)
    ]
    stuck = servos.compensator.stuck_offsets(servos.reference())
    trajectory = SettlingTrajectory(servos.driven_joints, goals, ticks, limits, stuck, is_reached)

    def update(cycle: ControlCycle) -> None:
        over = is_over is not None and is_over(cycle)
        trajectory.update(cycle.time_s, cycle.measured, end=over)

    loop.run(trajectory, update, speed_rad_s=speed_rad_s, compensated=False)
    servos.set_reference(trajectory.measured)
    return trajectory

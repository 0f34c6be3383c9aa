"""Online control: follow a goal that changes in every cycle, or a stream of targets."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from itertools import repeat
from typing import Protocol

import numpy as np

from ikservo.arguments import check_callable, check_iterable
from ikservo.arm.arm_protocol import ArmParts
from ikservo.arm.target_tracking import CartesianOrJointTarget, TargetTracker
from ikservo.control.loop import ControlCycle
from ikservo.control.streamed_servos import STALL_S
from ikservo.errors import RefusedError
from ikservo.guard.dead_man import DEAD_MAN_TIMEOUT_S, DeadManSwitch
from ikservo.kinematics.arrays import Vector
from ikservo.motion import KinematicLimits, OnlineTrajectory
from ikservo.planning.context import ArmContext
from ikservo.planning.reports import FollowResult, OnProgress
from ikservo.settling.settling import settle_at

# The first motion after torque comes on is slow until it is this close to its goal.
_TOLERANCE_RAD = 0.05
HAND_JERK_FACTOR = 8.0
"""Factor on the jerk of a speed class while the arm follows short moves of a hand or pointer."""
HAND_SLOW_S = 1.0
"""Time for which following a hand stays slow after torque comes on; its goals are always near."""

OnRefused = Callable[[RefusedError, Vector], None]  # also takes the kept goal (n,)


class GoalSource(Protocol):
    """A source of joint goals, one per control cycle; it must not block."""

    def next_goal(self, cycle: ControlCycle, /) -> Vector | None:
        """Return the goal (n,), rad or m, or None to brake and end."""
        ...

    def on_rejected(self, error: RefusedError, kept: Vector, /) -> None:
        """Handle the refusal of a goal; the arm keeps the previous one, ``kept`` (n,)."""
        ...


def follow_goals(
    arm: ArmParts,
    source: GoalSource,
    *,
    speed: str = "normal",
    jerk_factor: float = 1.0,
    settle_after_s: float = math.inf,
    slow_s: float = 0.0,
    by_tip: Callable[[], bool] = lambda: False,
) -> Vector | None:
    """Follow joint goals that ``source`` gives in every control cycle, until the source ends.

    Args:
        arm: The arm.
        source: Provides the goals.
        speed: The speed class.
        jerk_factor: Factor on the jerk of the speed class. Values above 1 shorten brief motions;
            the largest speed and acceleration stay the same.
        settle_after_s: Time at the goal after which joints are corrected by their measured
            positions, as at the end of a motion; a new goal ends the correction.
        slow_s: Minimum time for which the first motion is slow, even if the goals stay close.
        by_tip: Returns whether the goal was computed for a target of the tip; see ``settle_at``.

    Returns:
        The reference of the joints (n,) at the end: the last accepted goal, or the position at
        which braking ended; None if no goal was accepted.

    Raises:
        CalibrationError: The arm is not calibrated.
    """
    context, runner = arm.context, arm.runner
    context.require_zeros()
    with runner.requested():
        context.warm_up()
        runner.return_within_limits()
        allowed = runner.allowed_speed(speed)
        controller = _OnlineController(context, source, speed, allowed, jerk_factor, settle_after_s)
        controller.slow_s = slow_s
        runner.run(controller.start_trajectory, controller.on_cycle, speed)
        while controller.stands and controller.settled_goal is not None:
            goal, is_over = controller.settled_goal, controller.is_settling_over
            with runner.motion():
                settle_at(context, runner.loop, goal, speed, is_over, by_tip=by_tip())
            if controller.has_ended:
                break
            runner.run(controller.start_trajectory, controller.on_cycle, speed)
    if controller.error:
        raise controller.error
    return controller.settled_goal


def check_followed_goal(context: ArmContext, start: Vector, goal: Vector, speed: str) -> None:
    """Check a goal (n,) as ``follow_goals`` would from rest at ``start`` (n,), without motion.

    Raises:
        RefusedError: The arm would touch something on its path.
    """
    lower, upper = context.limits()
    limits = context.planner.motion_limits(speed)
    trajectory = OnlineTrajectory(start, limits, lower=lower, upper=upper)
    trajectory.retarget(goal, 0.0, lambda move: context.check_trajectory(move, start))


class _OnlineController:
    """Controller that retargets an online trajectory to new goals.

    Attributes:
        error: The error that the source raised, raised again once the arm has braked.
        settled_goal: See ``follow_goals``.
        stands: Whether the arm has been at its goal long enough to correct the joints.
        has_ended: Whether the source has ended.
        slow_s: See ``follow_goals``.
    """

    def __init__(
        self,
        context: ArmContext,
        source: GoalSource,
        speed: str,
        allowed: str,
        jerk_factor: float,
        settle_after_s: float,
    ) -> None:
        self._context, self._source, self._speed, self._first = context, source, speed, allowed
        self._jerk_factor, self._settle_after_s = jerk_factor, settle_after_s
        self.stands, self.has_ended, self.slow_s = False, False, 0.0
        self._limited = allowed != speed
        self._trajectory: OnlineTrajectory | None = None
        self._rest: Vector = np.zeros(0)
        self._requested: Vector = np.zeros(0)
        self._moves_since_s = math.inf  # time of the first accepted goal
        self._accepted: Vector = np.zeros(0)  # the last requested goal that the guard accepted
        self.error: Exception | None = None
        self.settled_goal: Vector | None = None

    def start_trajectory(self, start: Vector) -> OnlineTrajectory:
        lower, upper = self._context.limits()
        limits = self._motion_limits(self._first if self._limited else self._speed)
        self._trajectory = OnlineTrajectory(start, limits, lower=lower, upper=upper)
        self._rest, self._moves_since_s = start, math.inf
        if not self.stands:
            self._requested = start
        return self._trajectory

    def on_cycle(self, cycle: ControlCycle) -> None:
        trajectory = self._trajectory
        if trajectory is None or math.isfinite(trajectory.duration_s):
            return
        goal = self._next_goal(cycle)
        if goal is None:
            self._stop_trajectory(trajectory, cycle.time_s)
            self.stands = False
        elif not np.array_equal(goal, self._requested):
            self._retarget(trajectory, goal, cycle)
            self.stands = False
        elif len(self._accepted) and not self.stands:
            self.stands = cycle.time_s - trajectory.settles_at_s >= self._settle_after_s
            if self.stands:
                self._stop_trajectory(trajectory, cycle.time_s)
        if self._limited and cycle.time_s - self._moves_since_s >= self.slow_s:
            remaining = np.abs(trajectory.goal - trajectory.state(cycle.time_s).position)
            if remaining.max() <= _TOLERANCE_RAD:
                self._limited = False
                trajectory.set_limits(self._motion_limits(self._speed))

    def is_settling_over(self, cycle: ControlCycle) -> bool:
        """Check whether settling must end because the goal has changed or the source has ended."""
        goal = self._next_goal(replace(cycle, reference=self._accepted))
        if goal is None:
            self.has_ended = True
        return goal is None or not np.array_equal(goal, self._requested)

    def _next_goal(self, cycle: ControlCycle) -> Vector | None:
        try:
            return self._source.next_goal(cycle)
        except Exception as error:  # raised after the arm has been braked
            self.error = error
            return None

    def _retarget(self, trajectory: OnlineTrajectory, goal: Vector, cycle: ControlCycle) -> None:
        self._requested = goal
        try:
            trajectory.retarget(
                goal, cycle.time_s, lambda move: self._context.check_trajectory(move, self._rest)
            )
        except RefusedError as error:
            self._source.on_rejected(error, trajectory.goal)
        else:
            self._accepted, self._moves_since_s = goal, min(self._moves_since_s, cycle.time_s)

    def _stop_trajectory(self, trajectory: OnlineTrajectory, time_s: float) -> None:
        goal = trajectory.goal
        trajectory.set_limits(self._motion_limits("fast"))  # stops as soon as it can
        trajectory.stop(time_s)
        if len(self._accepted):
            lower, upper = self._context.limits()
            self.settled_goal = np.clip(self._accepted, lower, upper) - (goal - trajectory.goal)

    def _motion_limits(self, speed: str) -> list[KinematicLimits]:
        limits = self._context.planner.motion_limits(speed)
        return [replace(each, jerk_rad_s3=each.jerk_rad_s3 * self._jerk_factor) for each in limits]


class _TargetFollower:
    """Converter from a stream of targets to joint goals, one per control cycle."""

    def __init__(
        self,
        context: ArmContext,
        targets: Iterable[CartesianOrJointTarget | None],
        on_progress: OnProgress | None,
        on_refused: OnRefused | None = None,
    ) -> None:
        self._context, self._targets = context, iter(targets)
        self._report_refusal = on_refused
        self._report_progress = context.progress_reporter(on_progress)
        self._tracker = TargetTracker(context.chain, context.index)
        self._dead_man = DeadManSwitch()
        self._asked_s = math.inf
        self._goal: Vector | None = None
        self.count = self.unreached = self.refusals = 0
        self.reason = self.ended = ""

    def next_goal(self, cycle: ControlCycle) -> Vector | None:
        """Compute the goal (n,); None after a time-out without a target."""
        if self._goal is None:
            self._goal = self._context.servos.reference()
            self._dead_man.refresh(self._context.now_s())
        if self._report_progress:
            self._report_progress(cycle)
        delay_s = self._context.now_s() - self._asked_s
        if delay_s > STALL_S:  # this program was delayed, and not the stream
            self._dead_man.postpone(delay_s)
        target: CartesianOrJointTarget | None = None
        try:
            target = next(self._targets)
        except StopIteration:  # from now on there is no target in any cycle
            self.ended, self._targets = "end of the targets", repeat(None)
        now_s = self._asked_s = self._context.now_s()  # the stream may have blocked
        if self._dead_man.expired(now_s):
            self.ended = self.ended or f"no target for {DEAD_MAN_TIMEOUT_S} s"
            return None
        if target is not None:
            self._dead_man.refresh(now_s)
            self._goal, reached = self._tracker.solve_joints(target, self._goal)
            self.count += 1
            self.unreached += not reached
        return self._goal

    def on_rejected(self, error: RefusedError, kept: Vector) -> None:
        """Count a refused target."""
        self.refusals += 1
        self.reason = error.message
        if self._report_refusal:
            self._report_refusal(error, kept)


def follow(
    arm: ArmParts,
    targets: Iterable[CartesianOrJointTarget | None],
    speed: str = "normal",
    on_progress: OnProgress | None = None,
) -> FollowResult:
    """Follow a stream of targets, one in each control cycle, until it ends.

    Each cycle takes the next item: a ``Target``, a point (3,) [m], a pose (4, 4) of the tip,
    positions by joint [rad or m], or None for nothing new; a generator may block for a while. The
    arm moves there as fast as its speed class allows, without a stop or a jump, and keeps its IK
    branch. A target is valid for 0.3 s; without a new one, the arm then brakes. At the end, the sag
    under load is corrected, as by ``move_to``, at the last target that the guard accepted or at the
    position where the arm was braked, but not after a stop or an error in the stream.

    ``speed`` is the speed class; ``on_progress`` is called with a ``MotionProgress`` in every
    cycle.

    Raises:
        BadValueError: An item is not a target; the arm was braked first.
        StoppedError: ``stop`` was called; the arm holds.
    """
    check_callable("on_progress", on_progress)
    check_iterable("The stream of targets", targets, "an iterable of targets")
    return follow_targets(arm, targets, speed, on_progress)


def follow_targets(
    arm: ArmParts,
    targets: Iterable[CartesianOrJointTarget | None],
    speed: str,
    on_progress: OnProgress | None,
    on_refused: OnRefused | None = None,
    jerk_factor: float = 1.0,
    slow_s: float = 0.0,
) -> FollowResult:
    """Follow a stream of targets; see ``follow``. Each refusal is also reported at once."""
    context = arm.context
    context.require_zeros()
    context.model.speed(speed)
    follower = _TargetFollower(context, targets, on_progress, on_refused)
    started_s, warnings = context.now_s(), context.servos.warnings
    warnings.clear()
    with arm.runner.requested():
        goal = follow_goals(arm, follower, speed=speed, jerk_factor=jerk_factor, slow_s=slow_s)
        if goal is None:
            measured = context.servos.measure_positions()
        else:
            with arm.runner.motion():
                measured = settle_at(context, arm.runner.loop, goal, speed)
    return FollowResult(
        setpoints=follower.count,
        unreached=follower.unreached,
        refused=follower.refusals,
        reason=follower.reason,
        ended=follower.ended,
        measured_rad=context.index.by_name(measured),
        measured_tip_m=context.planner.tip(measured),
        duration_s=context.now_s() - started_s,
        warnings=tuple(warnings),
    )

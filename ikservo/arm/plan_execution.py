"""Execute plans with their trajectory, settling and report; lower an arm to its rest pose."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from math import degrees, radians
from typing import Any, cast

import numpy as np

from ikservo.arguments import check_callable
from ikservo.arm.arm_protocol import ArmParts
from ikservo.arm.motion_runner import MotionRunner
from ikservo.control.loop import ControlCycle
from ikservo.errors import (
    BadValueError,
    CollisionError,
    IkservoError,
    NotSettledError,
    PortError,
    RefusedError,
    StoppedError,
    shown,
)
from ikservo.guard import StopKind, StopReason
from ikservo.kinematics.arrays import Vector
from ikservo.motion import Trajectory
from ikservo.planning.context import ArmContext
from ikservo.planning.motion_plan import MotionPlan, has_moved, rebase_trajectory
from ikservo.planning.motions import Lower, MotionValue
from ikservo.planning.path_constraint import UNCONSTRAINED
from ikservo.planning.path_error import PathDeviation, PathRecorder
from ikservo.planning.reports import JointMoveResult, MoveResult, OnProgress
from ikservo.settling.backlash_approach import approach_goals
from ikservo.settling.settling import SettlingResult, lift_to_start, settle
from ikservo.settling.swings import MotionSwings
from ikservo.settling.tick_rounding import SettlingTarget

# Servos of this class come to rest within one or two ticks of 0.09° of their goals.
_POSITION_TOLERANCE_M = 0.002
_JOINT_TOLERANCE_RAD = radians(0.5)
_SAME_GOAL = 1e-6  # rad or m
# Piece of a path, in time, that is checked again in one control cycle. A braking arm covers half
# of `BRAKE_S` of its path.
_PIECE_S = 0.3

MoveReport = MoveResult | JointMoveResult
"""Report on the end of a plan for the tip or for joints."""


@dataclass(frozen=True, slots=True, eq=False)
class ExecutedMotion:
    """A plan that was executed.

    Attributes:
        plan: The plan; a new one if a limp arm has sunk since the first was made.
        settled: The joint positions at the end of the motion.
        path_error: The distance from the tip to its path; None if there was no path.
        swung: The joints that swung during the motion, with their amplitudes.
    """

    plan: MotionPlan
    settled: SettlingResult
    path_error: PathDeviation | None
    swung: tuple[str, ...]


def execute(arm: ArmParts, plan: MotionPlan, on_progress: OnProgress | None) -> MoveReport:
    """Execute a plan and report how it ended; see ``Arm.execute``."""
    check_plan(plan)
    executed = _run_around(arm, plan.motion, plan, on_progress)
    plan = executed.plan
    ends = zip(plan.names, plan.start.tolist(), plan.goal.tolist(), strict=True)
    moved = {name: goal for name, start, goal in ends if goal != start}
    return _make_report(arm.context, executed, moved)


def plan_and_execute(
    arm: ArmParts, motion: MotionValue[Any], on_progress: OnProgress | None
) -> MoveReport:
    """Plan a motion of the tip or of joints from the arm's present goal, execute it, and report."""
    executed = _run_around(arm, motion, None, on_progress)
    return _make_report(arm.context, executed, executed.plan.requested)


def _run_around(
    arm: ArmParts,
    motion: MotionValue[Any] | None,
    plan: MotionPlan | None,
    on_progress: OnProgress | None,
) -> ExecutedMotion:
    """Execute the plan of a motion; replan each time an obstacle enters its path.

    The stop in front of the obstacle is acknowledged. Any other stop, even during replanning, ends
    the request. ``motion`` is None if only its plan is known; ``plan`` is None if it must be made.
    """
    stops, replans = arm.context.servos.stop_request, getattr(motion, "replan", False)
    count = stops.count_at_request
    tries = 0
    while True:
        with stops.requested(count + tries, anew=tries > 0):
            try:
                if motion is not None and (plan is None or tries):
                    plan = arm.preflight.plan_from_held(motion)
                return run_plan(arm, cast("MotionPlan", plan), on_progress)
            except StoppedError:
                reason = arm.runner.stop_reason
                is_blocked = reason is not None and reason.kind is StopKind.OBSTACLE
                if not (replans and is_blocked) or stops.count != count + tries + 1:
                    raise
        arm.runner.acknowledge()
        tries += 1


def run_plan(arm: ArmParts, plan: MotionPlan, on_progress: OnProgress | None) -> ExecutedMotion:
    """Execute a plan.

    Raises:
        RefusedError: The arm has moved since the plan was made, there is no free path from the
            position to which a limp arm has sunk, or the guard stopped the motion.
    """
    check_plan(plan)
    check_callable("on_progress", on_progress)
    context, runner = arm.context, arm.runner
    with runner.requested():
        runner.check_speed(plan.speed)
        if not context.servos.torque.is_on and plan.limp_arm is None:
            _checked_trajectory(context, plan, runner.start_position())  # before torque comes on
        with runner.motion():
            if plan.motion is not None and plan.limp_arm is context:
                # The arm was limp when the plan was made. By now its servos hold.
                limits = context.planner.motion_limits(plan.speed)
                if has_moved(plan, context.servos.reference(), limits):
                    plan = arm.preflight.plan(plan.motion)
            return _run_motion(context, runner, plan, on_progress)


def _run_motion(
    context: ArmContext, runner: MotionRunner, plan: MotionPlan, on_progress: OnProgress | None
) -> ExecutedMotion:
    servos, limits = context.servos, context.planner.motion_limits(plan.speed)
    horn_rad_s, watch = context.model.speed(plan.speed).rad_s, _PathWatch(context)
    trajectory = _checked_trajectory(context, plan, servos.reference())
    if plan.cartesian_s >= plan.duration_s > 0.0:
        lift_to_start(context, runner.loop, servos.reference(), horn_rad_s)
        trajectory = _checked_trajectory(context, plan, servos.reference())
    measured = servos.measure_positions()
    target = SettlingTarget(context.chain, context.index, servos.driven_joints, plan, measured)
    started_s = context.now_s()
    recorder = PathRecorder(trajectory, plan.cartesian_s)
    swings = MotionSwings(servos.driven_joints)
    report_progress = context.progress_reporter(on_progress)

    def on_cycle(cycle: ControlCycle) -> None:
        watch.check(trajectory, plan.speed, cycle.time_s)
        recorder.record(cycle)
        swings.record(cycle)
        if report_progress is not None:
            report_progress(cycle)

    with runner.watching_scene():
        runner.loop.run(trajectory, on_cycle, speed_rad_s=horn_rad_s)
    motion_s = context.now_s() - started_s
    below = approach_goals(context, plan)
    settled = settle(runner.loop, servos, target, limits, horn_rad_s, motion_s, below)
    return ExecutedMotion(plan, settled, recorder.error(context.planner), swings.notes())


def _checked_trajectory(context: ArmContext, plan: MotionPlan, start: Vector) -> Trajectory:
    """Compute the trajectory of a plan from the arm's position (n,)."""
    end = plan.trajectory.state(plan.trajectory.duration_s).position
    if np.abs(end - plan.goal).max() > _SAME_GOAL:
        raise RefusedError(
            "The plan's goal differs from the end of its trajectory.",
            "Nothing was sent. Plan a motion to that goal.",
        )
    limits = context.planner.motion_limits(plan.speed)
    trajectory = rebase_trajectory(plan, start, limits, context.servos.names)
    context.check_streamed_path(trajectory, plan.speed)
    within = getattr(plan.motion, "within", UNCONSTRAINED)
    context.planner.check_constraint(within, trajectory, plan.speed)
    return trajectory


class _PathWatch:
    """Watcher that stops a motion in front of an obstacle that has entered the rest of the path.

    Whenever the scene has changed, the rest of the path is checked again, one piece per cycle. The
    first piece is longer than the stopping distance of the arm. The path must have been free when
    the motion started.
    """

    def __init__(self, context: ArmContext) -> None:
        self._context, self._checked, self._next_s = context, context.collision, math.inf

    def check(self, trajectory: Trajectory, speed: str, time_s: float) -> None:
        """Check the next piece of a trajectory after a time; request a stop if it is blocked."""
        servos = self._context.servos
        if self._context.collision is not self._checked:
            self._checked, self._next_s = self._context.collision, time_s
        if self._next_s >= trajectory.duration_s or servos.stop_request:
            return
        from_s, self._next_s = self._next_s, self._next_s + _PIECE_S
        try:
            self._context.check_piece(trajectory, from_s, self._next_s, speed)
        except CollisionError as error:
            reason = StopReason(StopKind.OBSTACLE, f"The scene was changed, and now {error.cause}.")
            servos.request_stop(reason)


def _make_report(
    context: ArmContext, executed: ExecutedMotion, joints: Mapping[str, float]
) -> MoveReport:
    """Make the report on a motion of the tip or of joints with the goals ``joints``."""
    plan, result, path_error = executed.plan, executed.settled, executed.path_error
    if plan.target_m is None or plan.solution is None:
        return _make_joint_report(context, joints, executed)
    planner, measured = context.planner, result.measured
    tip_m, target_m, solution = planner.tip(measured), plan.target_m, plan.solution
    error_m = float(np.linalg.norm(target_m - tip_m))
    limits = tuple(str(limit) for limit in solution.binding)
    report = MoveResult(
        target_m=target_m,
        commanded_tip_m=plan.tip_m,
        measured_tip_m=tip_m,
        error_m=error_m,
        duration_s=result.duration_s,
        reached=error_m <= _POSITION_TOLERANCE_M,
        binding=limits + executed.swung + result.residuals,
        orientation_error_rad=plan.orientation_error_rad
        + planner.rotation_between(plan.goal, measured),
        motion_s=result.motion_s,
        settling_s=result.settling_s,
        orientation_requested=plan.orientation_requested,
        orientation_change_rad=planner.rotation_between(plan.start, measured),
        path_error_rms_m=None if path_error is None else path_error.rms_m,
        path_error_max_m=None if path_error is None else path_error.max_m,
    )
    _require_settled(result, report)
    return report


def _make_joint_report(
    context: ArmContext, positions: Mapping[str, float], executed: ExecutedMotion
) -> JointMoveResult:
    result = executed.settled
    by_name = context.index.by_name(result.measured)
    measured = {name: by_name[name] for name in positions}
    error_rad = _max_error(measured, positions)
    report = JointMoveResult(
        goal_rad=dict(positions),
        measured_rad=measured,
        measured_tip_m=context.planner.tip(result.measured),
        error_rad=error_rad,
        duration_s=result.duration_s,
        reached=error_rad <= _JOINT_TOLERANCE_RAD,
        binding=executed.plan.clamped + executed.swung + result.residuals,
    )
    _require_settled(result, report)
    return report


def _require_settled(result: SettlingResult, report: MoveResult | JointMoveResult) -> None:
    """Raise an error with the report if joints still move more than their backlash allows."""
    if not result.unsettled:
        return
    names = ", ".join(result.unsettled)
    if isinstance(report, JointMoveResult):
        off = f"a joint is {degrees(report.error_rad):.1f}° off"
    else:
        off = f"the tip is {1000 * report.error_m:.1f} mm off"
        if report.path_error_max_m is not None:
            off += f", and was up to {1000 * report.path_error_max_m:.1f} mm off its path"
    raise NotSettledError(
        f"{names} did not settle in time; {off}.",
        "Check for a loose horn or a changing load.",
        report,
    )


def relax(arm: ArmParts, on_progress: OnProgress | None = None) -> JointMoveResult:
    """Lower the arm to its rest pose, then switch torque off; see ``Arm.relax``."""
    context, runner = arm.context, arm.runner
    context.require_zeros()
    with runner.requested(), runner.lock:
        context.servos.torque.check_idle()
        context.servos.check_stop()
        context.servos.torque.invalidated()  # the next torque-on sets limits that let it come down
        report = _try_lower(arm, on_progress)
        runner.disable_torque()
        if not isinstance(report, IkservoError):
            return report
        rest, state = dict(context.model.pose("rest")), runner.state()
        measured = {name: state.positions[name] for name in rest}
        return JointMoveResult(
            goal_rad=rest,
            measured_rad=measured,
            measured_tip_m=state.tip_m,
            error_rad=_max_error(measured, rest),
            duration_s=0.0,
            reached=False,
            binding=(f"The arm was not lowered: {report.message} Torque is off.",),
        )


def lower(arm: ArmParts, on_progress: OnProgress | None = None) -> JointMoveResult:
    """Lower the arm to its rest pose, or as far as the path is free; torque stays on."""
    with arm.context.servos.tolerate_heat():
        return cast("JointMoveResult", plan_and_execute(arm, Lower(), on_progress))


def _try_lower(arm: ArmParts, on_progress: OnProgress | None) -> JointMoveResult | IkservoError:
    """Lower the arm; return the error if that fails."""
    try:
        return lower(arm, on_progress)
    except (StoppedError, PortError):
        raise
    except IkservoError as error:
        if arm.context.servos.stop_request:
            raise
        return error


def _max_error(measured: Mapping[str, float], goals: Mapping[str, float]) -> float:
    return max((abs(measured[name] - goal) for name, goal in goals.items()), default=0.0)


def check_plan(plan: object) -> None:
    """Check that a value is a plan.

    Raises:
        BadValueError: The value is not a plan.
    """
    if not isinstance(plan, MotionPlan):
        raise BadValueError(
            "The plan", shown(plan), "a plan, such as arm.plan_to((0.25, 0.0, 0.15))"
        )

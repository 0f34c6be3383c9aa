"""Run a motion according to its kind, and compute where it would end."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, TypeVar, cast

from ikservo.arm.arm_protocol import ArmParts
from ikservo.arm.own_motion import OwnMotion
from ikservo.arm.plan_execution import plan_and_execute
from ikservo.kinematics.arrays import Vector
from ikservo.planning.context import ArmContext
from ikservo.planning.motions import MotionValue, MoveGripper, MoveJoints, MovePose, Wait
from ikservo.planning.preflight_planner import PreflightPlanner
from ikservo.planning.reports import OnProgress

R = TypeVar("R")
_LONGEST_SLEEP_S = 0.05  # a wait notices a stop within this time


def run_motion(arm: ArmParts, motion: MotionValue[R], on_progress: OnProgress | None) -> R:
    """Execute a motion from the held position, and return its result; see ``Arm.execute``."""
    match cast("MotionValue[Any]", motion):
        case MoveGripper() as gripper:
            from ikservo.arm.gripper import run_gripper  # noqa: PLC0415

            with arm.runner.undisturbed():
                result: object = run_gripper(arm, gripper, on_progress)
        case OwnMotion() as own:
            with arm.runner.undisturbed():
                result = own.run(arm, on_progress)
        case Wait() as pause:
            result = wait(arm.context, pause, watch_health=arm.context.servos.torque.is_on)
        case planned:
            result = plan_and_execute(arm, planned, on_progress)
    return cast("R", result)


def end_of_motion(
    context: ArmContext, preflight: PreflightPlanner, motion: MotionValue[Any], start: Vector
) -> tuple[Vector, float]:
    """Plan a motion from ``start`` (n,), rad or m; nothing moves.

    Returns:
        The joints (n,) at its end; its duration, in seconds, NaN if only its run can show that.

    Raises:
        IkservoError: The motion cannot be executed from ``start``.
    """
    match motion:
        case Wait():
            return start, motion.duration_s
        case MoveGripper():
            from ikservo.arm.gripper import plan_gripper  # noqa: PLC0415

            return plan_gripper(context, motion, start), math.nan
        case OwnMotion() as own:
            return own.end(context, start), math.nan
        case MovePose():
            inside = preflight.pose_within_limits(motion.name, start)
            plan = preflight.plan(MoveJoints(inside.positions, speed=motion.speed))
        case _:
            plan = preflight.plan(motion)
    return plan.goal, plan.duration_s


def wait(
    context: ArmContext,
    motion: Wait,
    on_wait: Callable[[], object] | None = None,
    *,
    watch_health: bool,
) -> None:
    """Wait while the arm holds; a stop or a fault of a servo ends it.

    ``on_wait`` is called repeatedly during the wait.

    Raises:
        StoppedError, RefusedError: The arm was stopped.
        BusError: A servo does not answer.
        ServoAlarmError: A servo reports a fault, has a wrong supply, or was reset.
    """
    end_s, left_s = context.now_s() + motion.duration_s, motion.duration_s
    while left_s > 0.0:  # checked at least once, however short it is
        context.servos.check_stop()
        context.servos.stop_request.check_request()
        if watch_health:
            context.servos.check_health()
        if on_wait is not None:
            on_wait()
        context.servos.clock.sleep_until(context.now_s() + min(left_s, _LONGEST_SLEEP_S))
        left_s = end_s - context.now_s()

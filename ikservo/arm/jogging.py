"""Jogging: move a joint or the tip in one direction while a key is held."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Protocol, cast

import numpy as np

from ikservo.arguments import parse_name, parse_number
from ikservo.arm.arm_protocol import ArmParts, KeepGoing
from ikservo.arm.target_tracking import TargetTracker
from ikservo.control.loop import ControlCycle
from ikservo.errors import BadValueError, CollisionError, RefusedError, UnknownNameError, shown
from ikservo.guard.dead_man import DeadManSwitch
from ikservo.kinematics.arrays import Vector
from ikservo.motion import KinematicLimits, OnlineTrajectory
from ikservo.planning.context import ArmContext
from ikservo.planning.reports import JogResult

JOG_DIRECTIONS = {
    "x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0), "-y": (0.0, -1.0, 0.0), "-z": (0.0, 0.0, -1.0),
    "up": (0.0, 0.0, 1.0), "down": (0.0, 0.0, -1.0),
}  # fmt: skip
"""Directions in which the tip can be jogged, in the base frame."""

NO_LONGER_REQUESTED = "no longer requested"
"""Reason that is reported if the caller has ended the jog."""

_MAX_DURATION_S = 60.0  # longest jog
_MAX_M_S = 0.5  # largest speed of the tip
_MAX_SPEED_FACTOR = 100.0  # largest speed of a joint; its speed class limits it further
_DEFAULT_M_S = 0.05  # speed of the tip, unless another is given
_AHEAD_S = 0.2  # the target of the tip is its position after this time


class _JogTarget(Protocol):
    """Source of the next goal of a jog."""

    def next_target(self, trajectory: OnlineTrajectory, time_s: float) -> Vector | str:
        """Return the next goal (n,) of the joints, or the reason why the jog ends."""
        ...


class _JointJog:
    """Motion of one joint to the end of its range."""

    def __init__(self, context: ArmContext, joint: str, speed: float) -> None:
        self._column, self._speed = context.index.column(joint), speed
        lower, upper = context.limits()
        self._limit = float((upper if speed > 0 else lower)[self._column])
        self._limit_text = f"{joint} is at its limit"

    def next_target(self, trajectory: OnlineTrajectory, time_s: float) -> Vector | str:
        position = trajectory.state(time_s).position[self._column]
        if (self._limit - position) * self._speed <= 1e-6 * abs(self._speed):
            return self._limit_text
        goal = trajectory.goal.copy()
        goal[self._column] = self._limit
        return goal


class _CartesianJog:
    """Motion of the tip along a line; each solution starts from the previous one."""

    def __init__(self, context: ArmContext, direction: Vector, speed_m_s: float) -> None:
        self._context, self._velocity = context, direction * speed_m_s
        self._tracker = TargetTracker(context.chain, context.index)
        self._start_m: Vector | None = None

    def next_target(self, trajectory: OnlineTrajectory, time_s: float) -> Vector | str:
        if self._start_m is None:
            self._start_m = self._context.planner.tip(trajectory.goal)
        point_m = self._start_m + self._velocity * (time_s + _AHEAD_S)
        goal, reached = self._tracker.solve_joints(point_m, trajectory.goal)
        return goal if reached else "the tip is at the edge of its reach"


class _JogController:
    """Controller that retargets the trajectory while a jog goes on and may brake freely."""

    def __init__(
        self, context: ArmContext, target: _JogTarget, keep_going: KeepGoing, braking_s: float
    ) -> None:
        self._context, self._target = context, target
        self._keep_going, self._braking_s = keep_going, braking_s
        self._dead_man = DeadManSwitch()
        self._trajectory: OnlineTrajectory | None = None
        self.ended = ""
        self.blocked = False

    def on_cycle(self, cycle: ControlCycle) -> None:
        trajectory = self._trajectory
        if trajectory is None or math.isfinite(trajectory.duration_s):
            return
        self.ended = self._end_reason(cycle.time_s)
        if not self.ended:
            self.ended = self._retarget(trajectory, cycle.time_s)
            self.blocked = bool(self.ended)
        if self.ended:
            trajectory.stop(cycle.time_s)

    def start_trajectory(self, trajectory: OnlineTrajectory) -> OnlineTrajectory:
        self._trajectory = trajectory
        self._dead_man.refresh(self._context.now_s())
        return trajectory

    def _end_reason(self, time_s: float) -> str:
        keep_going = self._keep_going()
        if keep_going is False or self._dead_man.expired(self._context.now_s()):
            return NO_LONGER_REQUESTED
        if keep_going:
            self._dead_man.refresh(self._context.now_s())
        return f"time limit of {_MAX_DURATION_S:.0f} s" if time_s > _MAX_DURATION_S else ""

    def _retarget(self, trajectory: OnlineTrajectory, time_s: float) -> str:
        goal = self._target.next_target(trajectory, time_s)
        if isinstance(goal, str):
            return goal
        try:
            trajectory.retarget(goal, time_s)
            # Include the travel until a later check could brake; none of it has been sent yet.
            times_s = (time_s, time_s + self._braking_s)
            start, end = (trajectory.state(at_s).position for at_s in times_s)
            self._context.check_straight_path(start, end)
        except CollisionError as error:  # its place on the braking path means nothing to users
            return f"{error.cause}."
        except RefusedError as error:
            return error.message
        return ""


def jog(arm: ArmParts, what: str, speed: float | None = None, *, wanted: KeepGoing) -> JogResult:
    """Move a joint or the tip in one direction while ``wanted`` returns True.

    Args:
        arm: The arm.
        what: A joint, or x, y, z, -x, -y, -z, up, down in the arm's base frame.
        speed: rad/s for a joint (m/s if prismatic) or m/s for the tip; negative to reverse. None
            means the arm file's slow speed, or 0.05 m/s for the tip.
        wanted: Called in every control cycle: True continues, False brakes and holds, None means no
            decision; after 0.3 s without a decision, the arm also brakes and holds.

    Returns:
        The final position and the reason for the end: no longer requested, a limit, or the guard.

    Raises:
        UnknownNameError: There is no such joint or direction.
        BadValueError: The speed is zero, not finite or too high.
    """
    if not callable(wanted):
        raise BadValueError("The argument `wanted`", shown(wanted), "a function")
    context, runner = arm.context, arm.runner
    with runner.requested():
        speed_class = runner.allowed_speed("normal")
        target, limits = _make_jog_target(context, what, speed, speed_class)
        lower, upper = context.limits()
        braking_s = max(limit.stopping_time_s for limit in limits)
        controller = _JogController(context, target, wanted, braking_s)
        started_s = context.now_s()
        context.warm_up()
        runner.return_within_limits()
        measured = runner.run(
            lambda start: controller.start_trajectory(
                OnlineTrajectory(start, limits, lower=lower, upper=upper)
            ),
            controller.on_cycle,
            speed_class,
        )
    return JogResult(
        ended=controller.ended,
        measured_rad=context.index.by_name(measured),
        measured_tip_m=context.planner.tip(measured),
        duration_s=context.now_s() - started_s,
        blocked=controller.blocked,
    )


def _make_jog_target(
    context: ArmContext, what: str, speed: float | None, speed_class: str
) -> tuple[_JogTarget, list[KinematicLimits]]:
    limits, names = context.planner.motion_limits(speed_class), context.index.names
    parse_name("The joint or direction", what)
    if what in names:
        column = context.index.column(what)
        slow = context.planner.motion_limits("slow")[column].speed_rad_s
        expected = f"rad/s, or m/s for a sliding joint, at most {_MAX_SPEED_FACTOR}"
        signed = _check_jog_speed(speed, slow, expected, _MAX_SPEED_FACTOR)
        own = limits[column]
        limits[column] = replace(own, speed_rad_s=min(abs(signed), own.speed_rad_s))
        return _JointJog(context, what, signed), limits
    if not isinstance(cast("object", what), str) or what not in JOG_DIRECTIONS:
        raise UnknownNameError("joint or direction", what, (*names, *JOG_DIRECTIONS))
    context.require_zeros()
    signed = _check_jog_speed(speed, _DEFAULT_M_S, f"m/s, at most {_MAX_M_S}", _MAX_M_S)
    return _CartesianJog(context, np.array(JOG_DIRECTIONS[what]), signed), limits


def _check_jog_speed(speed: float | None, default: float, expected: str, limit: float) -> float:
    signed = default if speed is None else parse_number("The speed", speed)
    if not 0.0 < abs(signed) <= limit:
        raise BadValueError("The speed", f"{signed:g}", f"{expected}, not zero")
    return signed

"""Online control: follow a joint goal that is chosen again in every control cycle."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from ikservo.arm.context import ArmContext
from ikservo.control.loop import ControlCycle
from ikservo.errors import RefusedError
from ikservo.kinematics.arrays import Vector
from ikservo.motion import OnlineTrajectory

__all__ = ["GoalSource", "follow_goals", "measured_with_held_gripper"]

# Servos without an integral part sag under their load by up to this; more is a jam.
_MAX_LIFT_RAD = 0.06
_NEAR_RAD = 0.002  # more than a tick
_REST_TIME_S = 0.2
_MAX_ITERATIONS = 6
# The first motion after torque comes on is slow until it is as near as this to what is wanted.
_TOLERANCE_RAD = 0.05


class GoalSource(Protocol):
    """Who says at each beat where the joints shall be; it must not wait for anything."""

    def next_goal(self, beat: ControlCycle) -> Vector | None:
        """Return where to go (n,), rad or m, or None to brake and end."""
        ...

    def on_rejected(self, error: RefusedError) -> None:
        """Hear why a goal was not taken; the arm stays with the one before."""
        ...


def follow_goals(
    arm: ArmContext, leader: GoalSource, speed: str, *, loaded: bool = False
) -> Vector | None:
    """Go after a leader's goals until it ends.

    Args:
        arm: Who goes.
        leader: Says where.
        speed: slow, normal or fast.
        loaded: Whether goals say where joints shall be, see ``standing``, from the first one on:
            what the servos' goals lead them by is kept. Else goals begin as the servos' own.

    Returns:
        Where the joints belong (n,): at the last goal that was taken, or as far short of it as
        braking came to rest; None where none was taken.
    """
    arm.zeros.require_known(arm.model.name)
    arm.warm_up()
    arm.return_within_limits()
    led = _OnlineController(arm, leader, speed, loaded=loaded)
    arm.drive(led.start_trajectory, led.on_cycle, speed)
    if led.error:
        raise led.error
    return led.belongs


def measured_with_held_gripper(arm: ArmContext, beat: ControlCycle) -> Vector:
    """Return where the joints of the chain are, and the others' goals (n,): a gripper presses on.

    The goals of joints under load are elsewhere: they lead them by what the load pulls.
    """
    beside = np.array([name not in arm.chain.names for name in arm.servos.names])
    return np.where(beside, beat.goals, beat.measured)


class _OnlineController:
    """Re-aims a pursuit when the leader wants something new, or load keeps joints from it."""

    def __init__(self, arm: ArmContext, leader: GoalSource, speed: str, *, loaded: bool) -> None:
        self._arm, self._leader, self._speed = arm, leader, speed
        self._loaded = loaded
        self._pursuit: OnlineTrajectory | None = None
        self._heard: Vector = np.zeros(0)
        self._wanted: Vector = np.zeros(0)  # of what was heard, the last that may be gone to
        self._ahead = np.zeros(0)
        self._looked_s = 0.0
        self._rounds = 0  # an arm that was only held is left where it stands
        self._careful = arm.allowed_speed(speed) != speed
        self.error: Exception | None = None
        self.belongs: Vector | None = None

    def start_trajectory(self, here: Vector) -> OnlineTrajectory:
        lower, upper = self._arm.limits()
        paces = self._arm.planner.motion_limits("slow" if self._careful else self._speed)
        self._pursuit = OnlineTrajectory(here, paces, lower=lower, upper=upper)
        self._heard, self._ahead = here, np.zeros_like(here)
        return self._pursuit

    def on_cycle(self, beat: ControlCycle) -> None:
        pursuit = self._pursuit
        if pursuit is None or math.isfinite(pursuit.duration_s):
            return
        if self._loaded:
            self._heard, self._loaded = measured_with_held_gripper(self._arm, beat), False
            self._ahead = pursuit.goal - self._heard
        goal = self._next_goal(beat)
        if goal is None:
            self._stop_trajectory(pursuit, beat.time_s)
        elif not np.array_equal(goal, self._heard):
            self._retarget(pursuit, goal, beat)
        elif self._rounds and self._is_at_rest(pursuit, beat):
            self._compensate_load(pursuit, beat)
        if self._careful and self._rounds:
            self._apply_speed(pursuit, beat.time_s)

    def _next_goal(self, beat: ControlCycle) -> Vector | None:
        try:
            return self._leader.next_goal(beat)
        except Exception as error:  # the arm is braked first, then it is told
            self.error = error
            return None

    def _retarget(self, pursuit: OnlineTrajectory, goal: Vector, beat: ControlCycle) -> None:
        self._heard = goal
        try:
            pursuit.retarget(goal + self._ahead, beat.time_s, self._arm.check_trajectory)
        except RefusedError as error:
            self._leader.on_rejected(error)
        else:
            self._wanted, self._rounds = goal, _MAX_ITERATIONS

    def _stop_trajectory(self, pursuit: OnlineTrajectory, time_s: float) -> None:
        aimed = pursuit.goal
        pursuit.set_limits(self._arm.planner.motion_limits("fast"))  # a gentle class stops no later
        pursuit.stop(time_s)
        if len(self._wanted):
            self.belongs = np.clip(self._wanted, *self._arm.limits()) - (aimed - pursuit.goal)

    def _apply_speed(self, pursuit: OnlineTrajectory, time_s: float) -> None:
        missing = np.abs(pursuit.goal - pursuit.state(time_s).position)
        if missing.max() <= _TOLERANCE_RAD:
            self._careful = False
            pursuit.set_limits(self._arm.planner.motion_limits(self._speed))

    def _is_at_rest(self, pursuit: OnlineTrajectory, beat: ControlCycle) -> bool:
        """Return whether the joints had time to come to rest since the last change."""
        return beat.time_s - max(pursuit.settles_at_s, self._looked_s) > _REST_TIME_S

    def _compensate_load(self, pursuit: OnlineTrajectory, beat: ControlCycle) -> None:
        """Lead the goals by what the load keeps resting joints from reaching."""
        residual = self._wanted - measured_with_held_gripper(
            self._arm, beat
        )  # a gripper that presses keeps its goal
        self._looked_s = beat.time_s
        if np.abs(residual).max() > _NEAR_RAD:
            self._rounds -= 1
            most, least = (
                np.maximum(self._ahead, _MAX_LIFT_RAD),
                np.minimum(self._ahead, -_MAX_LIFT_RAD),
            )
            self._ahead = np.clip(self._ahead + residual, least, most)
            pursuit.retarget(self._wanted + self._ahead, beat.time_s)

"""Leading the arm by the hand: joint goals that are chosen anew at each beat."""

from __future__ import annotations

import math
from typing import Protocol

import numpy as np

from ikservo.arm.skills.workings import Workings
from ikservo.arm.streaming.beat import Beat
from ikservo.errors import RefusedError
from ikservo.kinematics.se3 import Vector
from ikservo.motion import Pursuit

__all__ = ["Leader", "lead", "standing"]

# Servos without an integral part sag under their load by up to this; more is a jam.
_MOST_RAD = 0.06
_NEAR_RAD = 0.002  # more than a tick
_SETTLE_S = 0.2
_ROUNDS = 6
# The first motion after torque comes on is slow until it is as near as this to what is wanted.
_MET_RAD = 0.05


class Leader(Protocol):
    """Who says at each beat where the joints shall be; it must not wait for anything."""

    def goal(self, beat: Beat) -> Vector | None:
        """Return where to go (n,), rad or m, or None to brake and end."""
        ...

    def refused(self, error: RefusedError) -> None:
        """Hear why a goal was not taken; the arm stays with the one before."""
        ...


def lead(arm: Workings, leader: Leader, speed: str, *, loaded: bool = False) -> Vector | None:
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
    arm.zeros.check(arm.model.name)
    arm.rehearse()
    arm.walk_back()
    led = _Led(arm, leader, speed, loaded=loaded)
    arm.drive(led.begin, led.beat, speed)
    if led.error:
        raise led.error
    return led.belongs


def standing(arm: Workings, beat: Beat) -> Vector:
    """Return where the joints of the chain are, and the others' goals (n,): a gripper presses on.

    The goals of joints under load are elsewhere: they lead them by what the load pulls.
    """
    beside = np.array([name not in arm.chain.names for name in arm.servos.names])
    return np.where(beside, beat.goals, beat.measured)


class _Led:
    """Re-aims a pursuit when the leader wants something new, or load keeps joints from it."""

    def __init__(self, arm: Workings, leader: Leader, speed: str, *, loaded: bool) -> None:
        self._arm, self._leader, self._speed = arm, leader, speed
        self._loaded = loaded
        self._pursuit: Pursuit | None = None
        self._heard: Vector = np.zeros(0)
        self._wanted: Vector = np.zeros(0)  # of what was heard, the last that may be gone to
        self._ahead = np.zeros(0)
        self._looked_s = 0.0
        self._rounds = 0  # an arm that was only held is left where it stands
        self._careful = arm.allowed(speed) != speed
        self.error: Exception | None = None
        self.belongs: Vector | None = None

    def begin(self, here: Vector) -> Pursuit:
        lower, upper = self._arm.limits()
        paces = self._arm.planner.paces("slow" if self._careful else self._speed)
        self._pursuit = Pursuit(here, paces, lower=lower, upper=upper)
        self._heard, self._ahead = here, np.zeros_like(here)
        return self._pursuit

    def beat(self, beat: Beat) -> None:
        pursuit = self._pursuit
        if pursuit is None or math.isfinite(pursuit.duration_s):
            return
        if self._loaded:
            self._heard, self._loaded = standing(self._arm, beat), False
            self._ahead = pursuit.goal - self._heard
        goal = self._asked(beat)
        if goal is None:
            self._end(pursuit, beat.time_s)
        elif not np.array_equal(goal, self._heard):
            self._aim(pursuit, goal, beat)
        elif self._rounds and self._rests(pursuit, beat):
            self._lift(pursuit, beat)
        if self._careful and self._rounds:
            self._take_up_speed(pursuit, beat.time_s)

    def _asked(self, beat: Beat) -> Vector | None:
        try:
            return self._leader.goal(beat)
        except Exception as error:  # the arm is braked first, then it is told
            self.error = error
            return None

    def _aim(self, pursuit: Pursuit, goal: Vector, beat: Beat) -> None:
        self._heard = goal
        try:
            pursuit.aim(goal + self._ahead, beat.time_s, self._arm.check_move)
        except RefusedError as error:
            self._leader.refused(error)
        else:
            self._wanted, self._rounds = goal, _ROUNDS

    def _end(self, pursuit: Pursuit, time_s: float) -> None:
        aimed = pursuit.goal
        pursuit.run_at(self._arm.planner.paces("fast"))  # a gentle class stops no later
        pursuit.end(time_s)
        if len(self._wanted):
            self.belongs = np.clip(self._wanted, *self._arm.limits()) - (aimed - pursuit.goal)

    def _take_up_speed(self, pursuit: Pursuit, time_s: float) -> None:
        missing = np.abs(pursuit.goal - pursuit.state(time_s).position)
        if missing.max() <= _MET_RAD:
            self._careful = False
            pursuit.run_at(self._arm.planner.paces(self._speed))

    def _rests(self, pursuit: Pursuit, beat: Beat) -> bool:
        """Return whether the joints had time to come to rest since the last change."""
        return beat.time_s - max(pursuit.rest_s, self._looked_s) > _SETTLE_S

    def _lift(self, pursuit: Pursuit, beat: Beat) -> None:
        """Lead the goals by what the load keeps resting joints from reaching."""
        residual = self._wanted - standing(self._arm, beat)  # a gripper that presses keeps its goal
        self._looked_s = beat.time_s
        if np.abs(residual).max() > _NEAR_RAD:
            self._rounds -= 1
            most, least = np.maximum(self._ahead, _MOST_RAD), np.minimum(self._ahead, -_MOST_RAD)
            self._ahead = np.clip(self._ahead + residual, least, most)
            pursuit.aim(self._wanted + self._ahead, beat.time_s)

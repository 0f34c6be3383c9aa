"""Jogging: a joint or the tip moves in one direction while a key is held."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, cast

import numpy as np

from ikservo.arm.arguments import parse_number
from ikservo.arm.context import ArmContext
from ikservo.arm.following import TargetTracker
from ikservo.control.loop import ControlCycle
from ikservo.errors import BadValueError, RefusedError, UnknownNameError
from ikservo.guard import DeadManSwitch
from ikservo.kinematics.arrays import Vector
from ikservo.motion import KinematicLimits, OnlineTrajectory

__all__ = ["JOG_DIRECTIONS", "NO_LONGER_REQUESTED", "JogResult", "KeepGoing", "jog"]

JOG_DIRECTIONS = {
    "x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0), "-y": (0.0, -1.0, 0.0), "-z": (0.0, 0.0, -1.0),
    "up": (0.0, 0.0, 1.0), "down": (0.0, 0.0, -1.0),
}  # fmt: skip
"""Where the tip can be jogged, base frame."""

KeepGoing = Callable[[], bool | None]
"""Says at each beat whether the jog shall go on: True, False, or None for no news."""

NO_LONGER_REQUESTED = "no longer requested"
"""Why a jog ended whose caller ended it."""

_MAX_DURATION_S = 60.0
_MAX_M_S = 0.5
_MAX_SPEED_FACTOR = 100.0  # of a joint: it goes as fast as its class allows
_DEFAULT_M_S = 0.05
# The tip is aimed at where it will be after this time.
_AHEAD_S = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class JogResult:
    """How a jog ended.

    Attributes:
        ended: Why: no longer requested, a limit, or the message of the guard.
        measured_rad: Where the joints are in the end, rad or m by name.
        measured_tip_m: Where that puts the tip (3,), metres.
        duration_s: How long it took.
    """

    ended: str
    measured_rad: dict[str, float]
    measured_tip_m: Vector
    duration_s: float


class _JogTarget(Protocol):
    """Where a jog goes next."""

    def next_target(self, pursuit: OnlineTrajectory, time_s: float) -> Vector | str:
        """Return the joints (n,) to aim at, or why it cannot go on."""
        ...


class _JointJog:
    """One joint goes to the end of its range."""

    def __init__(self, arm: ArmContext, joint: str, speed: float) -> None:
        self._arm, self._column, self._speed = arm, arm.planner.joint_index(joint), speed
        lower, upper = arm.limits()
        self._limit = float((upper if speed > 0 else lower)[self._column])
        self._words = f"{joint} is at its limit"

    def next_target(self, pursuit: OnlineTrajectory, time_s: float) -> Vector | str:
        here = pursuit.state(time_s).position
        if (self._limit - here[self._column]) * self._speed <= 1e-6 * abs(self._speed):
            return self._words
        goal = pursuit.goal.copy()
        goal[self._column] = self._limit
        return goal


class _CartesianJog:
    """The tip goes along a line through where it was; joints are found from the last ones."""

    def __init__(self, arm: ArmContext, direction: Vector, speed_m_s: float) -> None:
        self._arm, self._velocity = arm, direction * speed_m_s
        self._tracker = TargetTracker(arm.chain, arm.servos.names)
        self._from_m: Vector | None = None

    def next_target(self, pursuit: OnlineTrajectory, time_s: float) -> Vector | str:
        if self._from_m is None:
            self._from_m = self._arm.planner.tip(pursuit.goal)
        point_m = self._from_m + self._velocity * (time_s + _AHEAD_S)
        goal, reached = self._tracker.solve_joints(point_m, pursuit.goal)
        return goal if reached else "the tip is at the edge of its reach"


class _Jogger:
    """Goes on while it is wanted, and nothing is in the way that braking takes."""

    def __init__(
        self, arm: ArmContext, aims: _JogTarget, wanted: KeepGoing, braked_s: float
    ) -> None:
        self._arm, self._aims, self._wanted, self._braked_s = arm, aims, wanted, braked_s
        self._dead_man = DeadManSwitch()
        self.pursuit: OnlineTrajectory | None = None
        self.ended = ""

    def on_cycle(self, beat: ControlCycle) -> None:
        pursuit = self.pursuit
        if pursuit is None or math.isfinite(pursuit.duration_s):
            return
        self.ended = self._stop_reason(beat.time_s) or self._retarget_ahead(pursuit, beat.time_s)
        if self.ended:
            pursuit.stop(beat.time_s)

    def start_trajectory(self, pursuit: OnlineTrajectory) -> OnlineTrajectory:
        self.pursuit = pursuit
        self._dead_man.refresh(self._arm.now_s())
        return pursuit

    def _stop_reason(self, time_s: float) -> str:
        wanted = self._wanted()
        if wanted is False or self._dead_man.expired(self._arm.now_s()):
            return NO_LONGER_REQUESTED
        if wanted:
            self._dead_man.refresh(self._arm.now_s())
        return f"time limit of {_MAX_DURATION_S:.0f} s" if time_s > _MAX_DURATION_S else ""

    def _retarget_ahead(self, pursuit: OnlineTrajectory, time_s: float) -> str:
        aim = self._aims.next_target(pursuit, time_s)
        if isinstance(aim, str):
            return aim
        try:
            pursuit.retarget(aim, time_s)
            # What is gone before the next look could brake it; nothing of it has been sent yet.
            ahead = (pursuit.state(at_s).position for at_s in (time_s, time_s + self._braked_s))
            self._arm.check_straight_path(*ahead)
        except RefusedError as error:
            return error.message
        return ""


def jog(arm: ArmContext, what: str, speed: float | None, wanted: KeepGoing) -> JogResult:
    """Jog a joint or the tip; see ``Arm.jog``."""
    if not callable(wanted):
        raise BadValueError("The argument wanted", repr(wanted), "a function")
    at_most = arm.allowed_speed("normal")
    aims, paces = _make_jog_target(arm, what, speed, at_most)
    lower, upper = arm.limits()
    jogger = _Jogger(arm, aims, wanted, max(pace.stopping_time_s for pace in paces))
    started_s = arm.now_s()
    arm.warm_up()
    arm.return_within_limits()
    measured = arm.drive(
        lambda here: jogger.start_trajectory(
            OnlineTrajectory(here, paces, lower=lower, upper=upper)
        ),
        jogger.on_cycle,
        at_most,
    )
    return JogResult(
        ended=jogger.ended,
        measured_rad=dict(zip(arm.servos.names, measured.tolist(), strict=True)),
        measured_tip_m=arm.planner.tip(measured),
        duration_s=arm.now_s() - started_s,
    )


def _make_jog_target(
    arm: ArmContext, what: str, speed: float | None, at_most: str
) -> tuple[_JogTarget, list[KinematicLimits]]:
    paces = arm.planner.motion_limits(at_most)
    if what in arm.servos.names:
        column = arm.planner.joint_index(what)
        slow = arm.planner.motion_limits("slow")[column].speed_rad_s
        wanted = _check_jog_speed(
            speed, slow, f"rad/s, or m/s of a slide, at most {_MAX_SPEED_FACTOR}", _MAX_SPEED_FACTOR
        )
        own = paces[column]
        paces[column] = replace(own, speed_rad_s=min(abs(wanted), own.speed_rad_s))
        return _JointJog(arm, what, wanted), paces
    if not isinstance(cast("object", what), str) or what not in JOG_DIRECTIONS:
        raise UnknownNameError("joint or direction", what, (*arm.servos.names, *JOG_DIRECTIONS))
    arm.zeros.require_known(arm.model.name)
    wanted = _check_jog_speed(speed, _DEFAULT_M_S, f"m/s, at most {_MAX_M_S}", _MAX_M_S)
    return _CartesianJog(arm, np.array(JOG_DIRECTIONS[what]), wanted), paces


def _check_jog_speed(speed: float | None, usual: float, expected: str, most: float) -> float:
    wanted = usual if speed is None else parse_number("The speed", speed)
    if not 0.0 < abs(wanted) <= most:
        raise BadValueError("The speed", f"{wanted:g}", f"{expected}, not zero")
    return wanted

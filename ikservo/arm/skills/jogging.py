"""Jogging: a joint or the tip goes on in one direction for as long as somebody wants it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol, cast

import numpy as np

from ikservo.arm.given import number
from ikservo.arm.skills.tracking import Tracker
from ikservo.arm.skills.workings import Workings
from ikservo.arm.streaming.beat import Beat
from ikservo.errors import BadValueError, RefusedError, UnknownNameError
from ikservo.guard import DeadMan
from ikservo.kinematics.se3 import Vector
from ikservo.motion import Pace, Pursuit

__all__ = ["DIRECTIONS", "NO_LONGER_REQUESTED", "JogReport", "Wanted", "jog"]

DIRECTIONS = {
    "x": (1.0, 0.0, 0.0), "y": (0.0, 1.0, 0.0), "z": (0.0, 0.0, 1.0),
    "-x": (-1.0, 0.0, 0.0), "-y": (0.0, -1.0, 0.0), "-z": (0.0, 0.0, -1.0),
    "up": (0.0, 0.0, 1.0), "down": (0.0, 0.0, -1.0),
}  # fmt: skip
"""Where the tip can be jogged, base frame."""

Wanted = Callable[[], bool | None]
"""Says at each beat whether the jog shall go on: True, False, or None for no news."""

NO_LONGER_REQUESTED = "no longer requested"
"""Why a jog ended whose caller ended it."""

_LONGEST_S = 60.0
_FASTEST_M_S = 0.5
_FASTEST = 100.0  # of a joint: it goes as fast as its class allows
_USUAL_M_S = 0.05
# The tip is aimed at where it will be after this time.
_AHEAD_S = 0.2


@dataclass(frozen=True, slots=True, eq=False)
class JogReport:
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


class _Aims(Protocol):
    """Where a jog goes next."""

    def ahead(self, pursuit: Pursuit, time_s: float) -> Vector | str:
        """Return the joints (n,) to aim at, or why it cannot go on."""
        ...


class _JointAims:
    """One joint goes to the end of its range."""

    def __init__(self, arm: Workings, joint: str, speed: float) -> None:
        self._arm, self._column, self._speed = arm, arm.planner.column(joint), speed
        lower, upper = arm.limits()
        self._limit = float((upper if speed > 0 else lower)[self._column])
        self._words = f"{joint} is at its limit"

    def ahead(self, pursuit: Pursuit, time_s: float) -> Vector | str:
        here = pursuit.state(time_s).position
        if (self._limit - here[self._column]) * self._speed <= 1e-6 * abs(self._speed):
            return self._words
        goal = pursuit.goal.copy()
        goal[self._column] = self._limit
        return goal


class _TipAims:
    """The tip goes along a line through where it was; joints are found from the last ones."""

    def __init__(self, arm: Workings, direction: Vector, speed_m_s: float) -> None:
        self._arm, self._velocity = arm, direction * speed_m_s
        self._tracker = Tracker(arm.chain, arm.servos.names)
        self._from_m: Vector | None = None

    def ahead(self, pursuit: Pursuit, time_s: float) -> Vector | str:
        if self._from_m is None:
            self._from_m = self._arm.planner.tip(pursuit.goal)
        point_m = self._from_m + self._velocity * (time_s + _AHEAD_S)
        goal, reached = self._tracker.joints(point_m, pursuit.goal)
        return goal if reached else "the tip is at the edge of its reach"


class _Jogger:
    """Goes on while it is wanted, and nothing is in the way that braking takes."""

    def __init__(self, arm: Workings, aims: _Aims, wanted: Wanted, braked_s: float) -> None:
        self._arm, self._aims, self._wanted, self._braked_s = arm, aims, wanted, braked_s
        self._dead_man = DeadMan()
        self.pursuit: Pursuit | None = None
        self.ended = ""

    def beat(self, beat: Beat) -> None:
        pursuit = self.pursuit
        if pursuit is None or math.isfinite(pursuit.duration_s):
            return
        self.ended = self._why_not(beat.time_s) or self._go_on(pursuit, beat.time_s)
        if self.ended:
            pursuit.end(beat.time_s)

    def begin(self, pursuit: Pursuit) -> Pursuit:
        self.pursuit = pursuit
        self._dead_man.fresh(self._arm.now_s())
        return pursuit

    def _why_not(self, time_s: float) -> str:
        wanted = self._wanted()
        if wanted is False or self._dead_man.check(self._arm.now_s()):
            return NO_LONGER_REQUESTED
        if wanted:
            self._dead_man.fresh(self._arm.now_s())
        return f"time limit of {_LONGEST_S:.0f} s" if time_s > _LONGEST_S else ""

    def _go_on(self, pursuit: Pursuit, time_s: float) -> str:
        aim = self._aims.ahead(pursuit, time_s)
        if isinstance(aim, str):
            return aim
        try:
            pursuit.aim(aim, time_s)
            # What is gone before the next look could brake it; nothing of it has been sent yet.
            ahead = (pursuit.state(at_s).position for at_s in (time_s, time_s + self._braked_s))
            self._arm.check_way(*ahead)
        except RefusedError as error:
            return error.message
        return ""


def jog(arm: Workings, what: str, speed: float | None, wanted: Wanted) -> JogReport:
    """Jog a joint or the tip; see ``Arm.jog``."""
    if not callable(wanted):
        raise BadValueError("The argument wanted", repr(wanted), "a function")
    at_most = arm.allowed("normal")
    aims, paces = _aims(arm, what, speed, at_most)
    lower, upper = arm.limits()
    jogger = _Jogger(arm, aims, wanted, max(pace.brake_s for pace in paces))
    started_s = arm.now_s()
    arm.rehearse()
    arm.walk_back()
    measured = arm.drive(
        lambda here: jogger.begin(Pursuit(here, paces, lower=lower, upper=upper)),
        jogger.beat,
        at_most,
    )
    return JogReport(
        ended=jogger.ended,
        measured_rad=dict(zip(arm.servos.names, measured.tolist(), strict=True)),
        measured_tip_m=arm.planner.tip(measured),
        duration_s=arm.now_s() - started_s,
    )


def _aims(arm: Workings, what: str, speed: float | None, at_most: str) -> tuple[_Aims, list[Pace]]:
    paces = arm.planner.paces(at_most)
    if what in arm.servos.names:
        column = arm.planner.column(what)
        slow = arm.planner.paces("slow")[column].speed_rad_s
        wanted = _checked(speed, slow, f"rad/s, or m/s of a slide, at most {_FASTEST}", _FASTEST)
        own = paces[column]
        paces[column] = replace(own, speed_rad_s=min(abs(wanted), own.speed_rad_s))
        return _JointAims(arm, what, wanted), paces
    if not isinstance(cast("object", what), str) or what not in DIRECTIONS:
        raise UnknownNameError("joint or direction", what, (*arm.servos.names, *DIRECTIONS))
    arm.zeros.check(arm.model.name)
    wanted = _checked(speed, _USUAL_M_S, f"m/s, at most {_FASTEST_M_S}", _FASTEST_M_S)
    return _TipAims(arm, np.array(DIRECTIONS[what]), wanted), paces


def _checked(speed: float | None, usual: float, expected: str, most: float) -> float:
    wanted = usual if speed is None else number("The speed", speed)
    if not 0.0 < abs(wanted) <= most:
        raise BadValueError("The speed", f"{wanted:g}", f"{expected}, not zero")
    return wanted

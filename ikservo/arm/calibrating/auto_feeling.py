"""One joint of an arm is driven gently until it stands against its stop, and backs off."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

from ikservo.arm.skills.workings import Workings
from ikservo.arm.streaming.beat import Beat
from ikservo.arm.streaming.states import load_percent
from ikservo.calibration.sweeping.feeler import Feeler, Touch
from ikservo.hardware.bus import ServoBus
from ikservo.kinematics.se3 import Vector
from ikservo.motion import Pace, Pursuit
from ikservo.registers import Role

__all__ = ["Felt", "feel"]

_SLOWER = 0.45  # than slow
_BACK_OFF_RAD = math.radians(4.0)  # the horn's angle
_ARRIVED_RAD = math.radians(1.5)
_LOOK_EVERY_S = 0.05


@dataclass(frozen=True, slots=True)
class Felt:
    """What one joint met.

    Attributes:
        position: How far it went, rad or m.
        touch: Whether that was a stop; `Touch.MOVING` where it went as far as it was sent.
    """

    position: float
    touch: Touch


def feel(
    arm: Workings,
    bus: ServoBus,
    joint: str,
    end: float,
    share: float,
    watch: Callable[[Vector], None],
) -> Felt:
    """Drive a joint towards a position until it stands against something, then back off.

    Args:
        arm: The arm behind its fence, torque on.
        bus: Its servos.
        joint: Which.
        end: Where it is sent, rad or m: past the stop that is looked for.
        share: How much of its torque the servo may use, 0 to 1; all of it again afterwards.
        watch: Takes the measured joints (n,) at each beat.

    Raises:
        StoppedError: The person interrupted; the arm holds.
        RefusedError: The guard stopped it; the arm holds.
    """
    search = _Search(arm, bus, joint, end, share, watch)
    try:
        arm.drive(search.begin, search.beat, "slow")
    finally:
        arm.servos.limit_force(joint, 1.0)
    return Felt(search.furthest, search.feeler.touch)


class _Search:
    def __init__(
        self,
        arm: Workings,
        bus: ServoBus,
        joint: str,
        end: float,
        share: float,
        watch: Callable[[Vector], None],
    ) -> None:
        self._arm, self._bus, self._joint, self._end = arm, bus, joint, end
        self._share, self._watch = share, watch
        self._column = arm.planner.column(joint)
        joint_map = arm.servos.fences[self._column].joint_map
        self._servo = bus.servos[joint_map.servo_id]
        self._per_horn = joint_map.unit_per_tick / joint_map.horn_rad_per_tick
        self._pursuit: Pursuit | None = None
        self._looked_s = -math.inf
        self._leaving = False
        self.feeler = Feeler(most_percent=100.0 * share)
        self.furthest = math.nan

    def begin(self, here: Vector) -> Pursuit:
        self._arm.servos.limit_force(self._joint, self._share)  # torque has come on by now
        lower, upper = self._arm.limits()
        self._pursuit = Pursuit(here, self._paces(), lower=lower, upper=upper)
        self._pursuit.aim(self._with(here, self._end), 0.0)
        return self._pursuit

    def _paces(self) -> list[Pace]:
        """Return paces that are slow and yet stop soon: the goal must not run past the stop."""
        planner = self._arm.planner
        pairs = zip(planner.paces("slow"), planner.paces("normal"), strict=True)
        return [replace(soon, speed_rad_s=_SLOWER * slow.speed_rad_s) for slow, soon in pairs]

    def beat(self, beat: Beat) -> None:
        self._watch(beat.measured)
        pursuit, at = self._pursuit, float(beat.measured[self._column])
        if pursuit is None or math.isfinite(pursuit.duration_s):
            return
        if self._leaving:
            if beat.time_s >= pursuit.rest_s:
                pursuit.end(beat.time_s)
            return
        self._look(at, float(beat.goals[self._column]))
        arrived = abs(at - self._end) <= _ARRIVED_RAD * self._per_horn
        if self.feeler.touch is not Touch.MOVING or (arrived and beat.time_s >= pursuit.rest_s):
            self._leave(pursuit, beat, at)

    def _look(self, at: float, goal: float) -> None:
        """Let the feeler look; the servo is asked how hard it presses only where that decides."""
        now_s, horn, ahead = self._arm.now_s(), at / self._per_horn, goal / self._per_horn
        if not self.feeler.suspects(now_s, horn, ahead):
            self.feeler = self.feeler.moved(now_s, horn)
        elif now_s - self._looked_s >= _LOOK_EVERY_S:
            self._looked_s = now_s
            load = load_percent(self._servo, self._bus.read(self._servo.id, Role.PRESENT_LOAD))
            self.feeler = self.feeler.felt(now_s, horn, ahead, load)

    def _leave(self, pursuit: Pursuit, beat: Beat, at: float) -> None:
        self.furthest, self._leaving = at, True
        back = math.copysign(_BACK_OFF_RAD * self._per_horn, self._end - at)
        if abs(self._end - at) < 2 * _ARRIVED_RAD * self._per_horn:
            back = 0.0
        pursuit.aim(self._with(beat.goals, at - back), beat.time_s)

    def _with(self, joints: Vector, position: float) -> Vector:
        goal = joints.copy()
        goal[self._column] = position
        return goal

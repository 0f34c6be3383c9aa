"""The jaws on their way: aimed, waited for where they creep, and stopped by what stands there."""

from __future__ import annotations

import math
from collections import deque
from dataclasses import replace

from ikservo.arm.skills.workings import Workings
from ikservo.arm.streaming.beat import Beat
from ikservo.kinematics.se3 import Vector
from ikservo.motion import Pace, Pursuit

__all__ = ["Jaws"]

_CALM = 0.65  # of the speed class
# A jaw that is told to move and has not for so long stands against something.
_STILL_S = 0.08
_STILL_TICKS = 3.0
# With its goal ahead and its force on, one that nothing stops goes on within this time.
_PRESSED_S = 0.5
_LEAST_LAG_RAD = 0.03  # of the horn, behind the goal
_SQUEEZE_RAD = 0.10  # how far the goal stays ahead of a jaw that presses; the torque limit rules
_MOST_LAG_RAD = 0.12  # so far ahead the goal waits for a jaw that has little force and creeps
_ARRIVED_RAD = 0.05


class Jaws:
    """Aims the gripper's joint at its goal, and stops pressing where something stands in the way.

    Args:
        arm: Whose gripper it is.
        column: The joint's place in vectors.
        goal: Where it goes, rad or m.

    Attributes:
        speed: slow, normal or fast.
        blocked: Whether something keeps the joint from going on.
    """

    def __init__(self, arm: Workings, column: int, goal: float) -> None:
        self._arm, self._column, self._goal = arm, column, goal
        self.speed = arm.allowed("normal")
        fence = arm.servos.fences[column]
        self._unit = fence.joint_map.unit_per_tick
        self._per_horn = self._unit / fence.joint_map.horn_rad_per_tick
        self._quiet = _STILL_TICKS * self._unit
        self._pressing, self._resting = _Stillness(self._quiet), _Stillness(self._quiet)
        self._pressed = _Stillness(self._quiet, _PRESSED_S)
        self._pursuit: Pursuit | None = None
        self._blocked_at = 0.0
        self.blocked = False

    def begin(self, here: Vector) -> Pursuit:
        """Return the course from the joints' goals (n,)."""
        lower, upper = self._arm.limits()
        self._pursuit = Pursuit(here, self._paces(), lower=lower, upper=upper)
        self._pursuit.aim(self._with(here, self._goal), 0.0)
        return self._pursuit

    def beat(self, beat: Beat) -> None:
        """Look at the joint and choose where its goal goes on to; end it where the joint rests."""
        pursuit = self._pursuit
        if pursuit is None or math.isfinite(pursuit.duration_s):
            return
        at, goal = float(beat.measured[self._column]), float(beat.goals[self._column])
        if self.blocked and abs(at - self._blocked_at) > self._quiet:
            self.blocked = False  # it crept on, or what stood there yielded
            self._pressing.restart()
        if not self.blocked:
            self._look(at, goal)
            pursuit.aim(self._with(beat.goals, self._aim(at, goal)), beat.time_s)
        still = self._pressed if self.blocked else self._resting
        if beat.time_s >= pursuit.rest_s and still.see(self._arm.now_s(), at):
            pursuit.end(beat.time_s)

    def arrived(self, at: float) -> bool:
        """Return whether the joint is where it was told to go."""
        return abs(at - self._goal) <= _ARRIVED_RAD * self._per_horn

    def _look(self, at: float, goal: float) -> None:
        self.blocked, self._blocked_at = self._stands(at, goal), at
        self._pressed.restart()

    def _paces(self) -> list[Pace]:
        """Return paces at which the goal turns round soon enough when the jaws meet something."""
        usual, fast = (self._arm.planner.paces(speed) for speed in (self.speed, "fast"))
        return [replace(quick, speed_rad_s=_CALM * pace.speed_rad_s)
                for pace, quick in zip(usual, fast, strict=True)]  # fmt: skip

    def _aim(self, at: float, goal: float) -> float:
        """Return where the goal goes on to: no further ahead of a jaw than it can follow."""
        if not self.blocked and abs(goal - at) <= _MOST_LAG_RAD * self._per_horn:
            return self._goal
        return at + math.copysign(_SQUEEZE_RAD * self._per_horn, goal - at)

    def _stands(self, at: float, goal: float) -> bool:
        """Return whether the jaw has not moved while its goal was well ahead of it."""
        ahead = (goal - at) * math.copysign(1.0, self._goal - at)
        if ahead <= _LEAST_LAG_RAD * self._per_horn:
            self._pressing.restart()
            return False
        return self._pressing.see(self._arm.now_s(), at)

    def _with(self, joints: Vector, position: float) -> Vector:
        goal = joints.copy()
        goal[self._column] = position
        return goal


class _Stillness:
    """Whether something has stayed within a band for a while."""

    def __init__(self, quiet: float, while_s: float = _STILL_S) -> None:
        self._quiet, self._while_s = quiet, while_s
        self._seen: deque[tuple[float, float]] = deque()

    def restart(self) -> None:
        self._seen.clear()

    def see(self, now_s: float, at: float) -> bool:
        self._seen.append((now_s, at))
        while len(self._seen) > 1 and self._seen[1][0] <= now_s - self._while_s:
            self._seen.popleft()
        old = self._seen[0][0] <= now_s - self._while_s
        return old and all(abs(at - was) <= self._quiet for _, was in self._seen)

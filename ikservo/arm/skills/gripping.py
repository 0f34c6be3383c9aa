"""The gripper: it opens, closes, goes to a width, and notices what stands between its jaws."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from ikservo.arm.given import number
from ikservo.arm.reports import Progress
from ikservo.arm.skills.workings import Workings
from ikservo.arm.streaming.beat import Beat
from ikservo.errors import BadValueError, IkservoError, UnknownNameError
from ikservo.kinematics.se3 import Vector
from ikservo.model.gripper import Gripper
from ikservo.motion import Pace, Pursuit

__all__ = ["GripReport", "Opening", "grip"]

Opening = Literal["open", "close"]

_FORCE = 0.3  # of a servo's torque: holds a full cup, and can be held for an hour
_LEAST_FORCE = 0.05
_CALM = 0.65  # of the speed class
# A jaw that is told to move and has not for so long stands against something.
_STILL_S = 0.08
_STILL_TICKS = 3.0
_LEAST_LAG_RAD = 0.03  # of the horn, behind the goal
_SQUEEZE_RAD = 0.10  # how far the goal stays ahead of a jaw that presses; the torque limit rules
_MOST_LAG_RAD = 0.12  # so far ahead the goal waits for a jaw that has little force and creeps
_ARRIVED_RAD = 0.05
# Jaws that come to stand in this share of their way from open were too weak to close.
_WIDE = 0.05


@dataclass(frozen=True, slots=True)
class GripReport:
    """How a motion of the gripper ended.

    Attributes:
        grasped: Whether the jaws hold something: they stand short of where they were closing to.
        reached: Whether they are where they were told to go.
        position_rad: Where the gripper's joint is, rad or m.
        width_m: How far the jaws are apart; None where the arm file does not know.
        load_percent: What the servo reports: share of its torque or current.
        force: The share of its torque that it may use.
        duration_s: How long it took.
    """

    grasped: bool
    reached: bool
    position_rad: float
    width_m: float | None
    load_percent: float | None
    force: float
    duration_s: float


class _Stillness:
    """Whether something has stayed within a band for a while."""

    def __init__(self, quiet: float) -> None:
        self._quiet = quiet
        self._seen: deque[tuple[float, float]] = deque()

    def restart(self) -> None:
        self._seen.clear()

    def see(self, now_s: float, at: float) -> bool:
        self._seen.append((now_s, at))
        while len(self._seen) > 1 and self._seen[1][0] <= now_s - _STILL_S:
            self._seen.popleft()
        old = self._seen[0][0] <= now_s - _STILL_S
        return old and all(abs(at - was) <= self._quiet for _, was in self._seen)


class _Jaws:
    """Aims the gripper's joint at its goal, and stops pressing where something stands in the way.

    Args:
        arm: Whose gripper it is.
        column: The joint's place in vectors.
        goal: Where it goes, rad or m.
    """

    def __init__(self, arm: Workings, column: int, goal: float) -> None:
        self._arm, self._column, self._goal = arm, column, goal
        self.speed = arm.allowed("normal")
        fence = arm.servos.fences[column]
        self._unit = fence.joint_map.unit_per_tick
        self._per_horn = self._unit / fence.joint_map.horn_rad_per_tick
        quiet = _STILL_TICKS * self._unit
        self._pressing, self._resting = _Stillness(quiet), _Stillness(quiet)
        self._pursuit: Pursuit | None = None
        self.blocked = False

    def begin(self, here: Vector) -> Pursuit:
        lower, upper = self._arm.limits()
        self._pursuit = Pursuit(here, self._paces(), lower=lower, upper=upper)
        self._pursuit.aim(self._with(here, self._goal), 0.0)
        return self._pursuit

    def beat(self, beat: Beat) -> None:
        pursuit = self._pursuit
        if pursuit is None or math.isfinite(pursuit.duration_s):
            return
        at, goal = float(beat.measured[self._column]), float(beat.goals[self._column])
        if not self.blocked:
            self.blocked = self._stands(at, goal)
            pursuit.aim(self._with(beat.goals, self._aim(at, goal)), beat.time_s)
        if beat.time_s >= pursuit.rest_s and (
            self.blocked or self._resting.see(self._arm.now_s(), at)
        ):
            pursuit.end(beat.time_s)

    def arrived(self, at: float) -> bool:
        """Return whether the joint is where it was told to go."""
        return abs(at - self._goal) <= _ARRIVED_RAD * self._per_horn

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


def grip(
    arm: Workings,
    to: Opening | float,
    force: float | None,
    on_progress: Callable[[Progress], None] | None,
) -> GripReport:
    """Move the gripper; see ``Arm.gripper``."""
    gripper = _gripper(arm)
    column = arm.planner.column(gripper.joint)
    goal, share = _goal(arm, gripper, column, to), _share(force)
    jaws = _Jaws(arm, column, goal)
    started_s = arm.now_s()
    arm.walk_back()

    def begin(here: Vector) -> Pursuit:
        arm.servos.limit_force(gripper.joint, share)  # torque is on by now, and it was set anew
        return jaws.begin(here)

    def on_beat(beat: Beat) -> None:
        jaws.beat(beat)
        if on_progress:
            on_progress(Progress(beat.time_s, beat.duration_s, arm.planner.tip(beat.measured)))

    arm.drive(begin, on_beat, jaws.speed)
    state = arm.servos.states()[column]
    at = state.position_rad
    reached = jaws.arrived(at)
    closed = (at - gripper.open) / (gripper.closed - gripper.open)
    closing = (goal - gripper.open) * (gripper.closed - gripper.open) > 0
    return GripReport(
        grasped=jaws.blocked and closing and closed > _WIDE and not reached,
        reached=reached,
        position_rad=at,
        width_m=gripper.width_m(at),
        load_percent=state.load_percent,
        force=share,
        duration_s=arm.now_s() - started_s,
    )


def _gripper(arm: Workings) -> Gripper:
    if arm.model.gripper is None:
        raise IkservoError(f"{arm.model.title} has no gripper.", "Its arm file names none.")
    return arm.model.gripper


def _goal(arm: Workings, gripper: Gripper, column: int, to: Opening | float) -> float:
    """Return where the joint shall go: inside this very arm's limits."""
    low, high = (float(side[column]) for side in arm.limits())
    if isinstance(to, str):
        ends = {"open": gripper.open, "close": gripper.closed}
        if to not in ends:
            raise UnknownNameError("motion of the gripper", to, ends)
        return min(max(ends[to], low), high)
    width_m, known = number("The width", to), gripper.range_m()
    if known is None:
        raise BadValueError(
            "The width", f"{width_m:g} m", "open or close: the arm file knows no widths ([gripper])"
        )
    if not known[0] - 1e-9 <= width_m <= known[1] + 1e-9:
        raise BadValueError("The width", f"{width_m:g} m", f"{known[0]:.3f} to {known[1]:.3f} m")
    return min(max(gripper.position(width_m), low), high)


def _share(force: float | None) -> float:
    share = _FORCE if force is None else number("The force", force)
    if not _LEAST_FORCE <= share <= 1.0:
        raise BadValueError("The force", f"{share:g}", f"a share from {_LEAST_FORCE} to 1")
    return share

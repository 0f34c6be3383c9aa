"""Gripper motions: open, close, move to a width, detect an object between the fingers."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

from ikservo.arm.arguments import parse_number
from ikservo.arm.context import ArmContext
from ikservo.arm.reports import MotionProgress
from ikservo.control.loop import ControlCycle
from ikservo.errors import BadValueError, IkservoError, UnknownNameError
from ikservo.kinematics.arrays import Vector
from ikservo.model.model import Gripper
from ikservo.motion import KinematicLimits, OnlineTrajectory

__all__ = ["GraspResult", "GripperCommand", "GripperMotion", "move_gripper"]


_SPEED_FRACTION = 0.65  # of the speed class
# A jaw that is told to move and has not for so long stands against something.
_AT_REST_S = 0.08
_AT_REST_TICKS = 3.0
# With its goal ahead and its force on, one that nothing stops goes on within this time.
_PRESSED_S = 0.5
_MIN_LAG_RAD = 0.03  # of the horn, behind the goal
_SQUEEZE_RAD = 0.10  # how far the goal stays ahead of a jaw that presses; the torque limit rules
_MAX_LAG_RAD = 0.12  # so far ahead the goal waits for a jaw that has little force and creeps
_ARRIVED_RAD = 0.05


class GripperMotion:
    """Aims the gripper's joint at its goal, and stops pressing where something stands in the way.

    Args:
        arm: Whose gripper it is.
        column: The joint's place in vectors.
        goal: Where it goes, rad or m.

    Attributes:
        speed: slow, normal or fast.
        blocked: Whether something keeps the joint from going on.
    """

    def __init__(self, arm: ArmContext, column: int, goal: float) -> None:
        self._arm, self._column, self._goal = arm, column, goal
        self.speed = arm.allowed_speed("normal")
        fence = arm.servos.fences[column]
        self._unit = fence.joint_map.unit_per_tick
        self._per_horn = self._unit / fence.joint_map.horn_rad_per_tick
        self._quiet = _AT_REST_TICKS * self._unit
        self._pressing, self._resting = _JointAtRest(self._quiet), _JointAtRest(self._quiet)
        self._pressed = _JointAtRest(self._quiet, _PRESSED_S)
        self._pursuit: OnlineTrajectory | None = None
        self._blocked_at = 0.0
        self.blocked = False

    def start_trajectory(self, here: Vector) -> OnlineTrajectory:
        """Return the course from the joints' goals (n,)."""
        lower, upper = self._arm.limits()
        self._pursuit = OnlineTrajectory(here, self._gripper_limits(), lower=lower, upper=upper)
        self._pursuit.retarget(self._with_position(here, self._goal), 0.0)
        return self._pursuit

    def on_cycle(self, beat: ControlCycle) -> None:
        """Look at the joint and choose where its goal goes on to; end it where the joint rests."""
        pursuit = self._pursuit
        if pursuit is None or math.isfinite(pursuit.duration_s):
            return
        at, goal = float(beat.measured[self._column]), float(beat.goals[self._column])
        if self.blocked and abs(at - self._blocked_at) > self._quiet:
            self.blocked = False  # it crept on, or what stood there yielded
            self._pressing.restart()
        if not self.blocked:
            self._update_contact(at, goal)
            pursuit.retarget(
                self._with_position(beat.goals, self._choose_goal(at, goal)), beat.time_s
            )
        still = self._pressed if self.blocked else self._resting
        if beat.time_s >= pursuit.settles_at_s and still.update(self._arm.now_s(), at):
            pursuit.stop(beat.time_s)

    def has_arrived(self, at: float) -> bool:
        """Return whether the joint is where it was told to go."""
        return abs(at - self._goal) <= _ARRIVED_RAD * self._per_horn

    def _update_contact(self, at: float, goal: float) -> None:
        self.blocked, self._blocked_at = self._is_blocked(at, goal), at
        self._pressed.restart()

    def _gripper_limits(self) -> list[KinematicLimits]:
        """Return paces at which the goal turns round soon enough when the jaws meet something."""
        usual, fast = (self._arm.planner.motion_limits(speed) for speed in (self.speed, "fast"))
        return [replace(quick, speed_rad_s=_SPEED_FRACTION * pace.speed_rad_s)
                for pace, quick in zip(usual, fast, strict=True)]  # fmt: skip

    def _choose_goal(self, at: float, goal: float) -> float:
        """Return where the goal goes on to: no further ahead of a jaw than it can follow."""
        if not self.blocked and abs(goal - at) <= _MAX_LAG_RAD * self._per_horn:
            return self._goal
        return at + math.copysign(_SQUEEZE_RAD * self._per_horn, goal - at)

    def _is_blocked(self, at: float, goal: float) -> bool:
        """Return whether the jaw has not moved while its goal was well ahead of it."""
        ahead = (goal - at) * math.copysign(1.0, self._goal - at)
        if ahead <= _MIN_LAG_RAD * self._per_horn:
            self._pressing.restart()
            return False
        return self._pressing.update(self._arm.now_s(), at)

    def _with_position(self, joints: Vector, position: float) -> Vector:
        goal = joints.copy()
        goal[self._column] = position
        return goal


class _JointAtRest:
    """Whether something has stayed within a band for a while."""

    def __init__(self, quiet: float, while_s: float = _AT_REST_S) -> None:
        self._quiet, self._while_s = quiet, while_s
        self._seen: deque[tuple[float, float]] = deque()

    def restart(self) -> None:
        self._seen.clear()

    def update(self, now_s: float, at: float) -> bool:
        self._seen.append((now_s, at))
        while len(self._seen) > 1 and self._seen[1][0] <= now_s - self._while_s:
            self._seen.popleft()
        old = self._seen[0][0] <= now_s - self._while_s
        return old and all(abs(at - was) <= self._quiet for _, was in self._seen)


GripperCommand = Literal["open", "close"]

_FORCE = 0.3  # of a servo's torque: holds a full cup, and can be held for an hour
_MIN_FORCE = 0.05  # friction takes 2 to 5 % of the torque of the servos we know
# Jaws that come to stand in this share of their way from open were too weak to close.
_WIDE = 0.05


@dataclass(frozen=True, slots=True)
class GraspResult:
    """How a motion of the gripper ended.

    Attributes:
        grasped: Whether the jaws stand short of where they were closing to, and have not yielded
            to their force for half a second. Mostly something is between them. Jaws that stick, by
            more than their force, look the same to the servo: try more force where that may be.
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


def move_gripper(
    arm: ArmContext,
    to: GripperCommand | float,
    force: float | None,
    on_progress: Callable[[MotionProgress], None] | None,
) -> GraspResult:
    """Move the gripper; see ``Arm.gripper``."""
    gripper = _require_gripper(arm)
    column = arm.planner.joint_index(gripper.joint)
    goal, share = _goal_position(arm, gripper, column, to), _torque_fraction(force)
    _check_gripper_path(arm, column, goal)
    jaws = GripperMotion(arm, column, goal)
    started_s = arm.now_s()
    arm.return_within_limits()

    def begin(here: Vector) -> OnlineTrajectory:
        arm.servos.limit_force(gripper.joint, share)  # torque is on by now, and it was set anew
        return jaws.start_trajectory(here)

    def on_cycle(beat: ControlCycle) -> None:
        jaws.on_cycle(beat)
        if on_progress:
            on_progress(arm.progress(beat))

    arm.drive(begin, on_cycle, jaws.speed)
    state = arm.servos.read_states()[column]
    at = state.position_rad
    reached = jaws.has_arrived(at)
    closed = (at - gripper.open) / (gripper.closed - gripper.open)
    closing = (goal - gripper.open) * (gripper.closed - gripper.open) > 0
    return GraspResult(
        grasped=jaws.blocked and closing and closed > _WIDE and not reached,
        reached=reached,
        position_rad=at,
        width_m=gripper.width_m(at),
        load_percent=state.load_percent,
        force=share,
        duration_s=arm.now_s() - started_s,
    )


def _check_gripper_path(arm: ArmContext, column: int, goal: float) -> None:
    here = arm.servos.measure_positions()
    there = here.copy()
    there[column] = goal
    arm.check_straight_path(here, there)


def _require_gripper(arm: ArmContext) -> Gripper:
    if arm.model.gripper is None:
        raise IkservoError(
            f'Arm "{arm.model.name}" has no gripper.',
            'Its arm file has no joint with role = "gripper".',
        )
    return arm.model.gripper


def _goal_position(
    arm: ArmContext, gripper: Gripper, column: int, to: GripperCommand | float
) -> float:
    """Return where the joint shall go: inside this very arm's limits."""
    low, high = (float(side[column]) for side in arm.limits())
    if isinstance(to, str):
        ends = {"open": gripper.open, "close": gripper.closed}
        if to not in ends:
            raise UnknownNameError("motion of the gripper", to, ends)
        return min(max(ends[to], low), high)
    width_m, known = parse_number("The width", to), gripper.range_m()
    if known is None:
        raise BadValueError(
            "The width", f"{width_m:g} m", "open or close: the arm file has no widths ([gripper])"
        )
    if not known[0] - 1e-9 <= width_m <= known[1] + 1e-9:
        raise BadValueError("The width", f"{width_m:g} m", f"{known[0]:.3f} to {known[1]:.3f} m")
    return min(max(gripper.position(width_m), low), high)


def _torque_fraction(force: float | None) -> float:
    share = _FORCE if force is None else parse_number("The force", force)
    if not _MIN_FORCE <= share <= 1.0:
        raise BadValueError("The force", f"{share:g}", f"a share from {_MIN_FORCE} to 1")
    return share

"""Gripper motions: open, close, move to a width, detect an object between the fingers."""

from __future__ import annotations

import math
from dataclasses import replace

from ikservo.arm.arm_protocol import ArmParts
from ikservo.control.loop import ControlCycle
from ikservo.control.stillness import StillnessDetector
from ikservo.errors import BadValueError, IkservoError
from ikservo.kinematics.arrays import Vector
from ikservo.model.arm_model import Gripper
from ikservo.model.servo_torque import find_servo_torque
from ikservo.motion import OnlineTrajectory
from ikservo.planning.context import ArmContext
from ikservo.planning.motions import MoveGripper
from ikservo.planning.reports import GraspResult, OnProgress

_SPEED_FRACTION = 0.65  # the jaws move at this fraction of the speed class
# A jaw is blocked if it has moved by no more than this in this time while its goal is ahead.
_AT_REST_S = 0.08
_AT_REST_TICKS = 3.0
# A jaw that is not blocked moves within this time if its goal is ahead and its force is on.
_PRESSED_S = 0.5
_MIN_LAG_RAD = 0.03  # a goal that leads the horn by less is not ahead
_SQUEEZE_RAD = 0.10  # lead of the goal while a jaw presses; the torque limit sets the force
_MAX_LAG_RAD = 0.12  # at this lead the goal waits for a jaw that moves slowly for lack of force
# A blocked jaw may slip by some ticks. Its goal must then not start to move ahead, because it could
# not return before the guard reports that the joint does not follow.
_MOST_AHEAD_RAD = 0.15
_MAX_S = 60.0  # longest motion: jaws that swing on something soft do not come to rest
_ARRIVED_RAD = 0.05  # at the horn: a jaw this near its goal has reached it


class GripperMotion:
    """Motion of the gripper's joint to its goal; stops pressing if something blocks the joint.

    Args:
        context: The arm.
        speed: slow, normal or fast.
        joint: The gripper's joint.
        goal: The joint goal, rad or m.

    Attributes:
        speed: slow, normal or fast.
        blocked: Whether something blocks the joint.
    """

    def __init__(self, context: ArmContext, speed: str, joint: str, goal: float) -> None:
        self._context, self.speed, self._joint, self._goal = context, speed, joint, goal
        self._column = context.index.column(joint)
        joint_map = context.servos.driven_joints[self._column].joint_map
        self._per_horn = joint_map.unit_per_horn_rad
        self._tolerance = _AT_REST_TICKS * joint_map.unit_per_tick
        self._blocking = self._resting = StillnessDetector(_AT_REST_S, self._tolerance)
        self._pressing = StillnessDetector(_PRESSED_S, self._tolerance)
        self._trajectory: OnlineTrajectory | None = None
        self._blocked_at = 0.0
        self.blocked = False

    def start_trajectory(self, start: Vector) -> OnlineTrajectory:
        """Compute the trajectory from the joint goals (n,)."""
        lower, upper = self._context.limits()
        usual, fast = (self._context.planner.motion_limits(speed) for speed in (self.speed, "fast"))
        # Fast acceleration, so that the goal reverses soon enough when the jaws meet something.
        limits = [
            replace(quick, speed_rad_s=_SPEED_FRACTION * limit.speed_rad_s)
            for limit, quick in zip(usual, fast, strict=True)
        ]
        self._trajectory = OnlineTrajectory(start, limits, lower=lower, upper=upper)
        self._trajectory.retarget(self._with_position(start, self._goal), 0.0)
        return self._trajectory

    def on_cycle(self, cycle: ControlCycle) -> None:
        """Retarget according to the measured joint; end the trajectory once the joint rests."""
        trajectory = self._trajectory
        if trajectory is None or math.isfinite(trajectory.duration_s):
            return
        at, goal = float(cycle.measured[self._column]), float(cycle.goals[self._column])
        if self.blocked and abs(at - self._blocked_at) > self._tolerance:
            self.blocked = False  # the jaw moved on, or the object yielded
            self._blocking = self._blocking.restarted()
        if not self.blocked:
            self.blocked, self._blocked_at = self._update_blocking(at, goal), at
            self._pressing = self._pressing.restarted()
            # The next goal is not further ahead of the jaw than the jaw can follow.
            is_free = not self.blocked and abs(goal - at) <= _MAX_LAG_RAD * self._per_horn
            most = _MOST_AHEAD_RAD * self._per_horn
            lead = min(max(self._goal - at, -most), most)
            if not is_free:
                lead = math.copysign(_SQUEEZE_RAD * self._per_horn, goal - at)
            trajectory.retarget(self._with_position(cycle.goals, at + lead), cycle.time_s)
        rests = cycle.time_s >= trajectory.settles_at_s and self._update_rest(at)
        if rests or cycle.time_s >= _MAX_S:
            trajectory.stop(cycle.time_s)

    def has_arrived(self, at: float) -> bool:
        """Check whether the joint is at its goal."""
        return abs(at - self._goal) <= _ARRIVED_RAD * self._per_horn

    def _update_rest(self, at: float) -> bool:
        """Check whether the joint is at rest; a joint that presses must be at rest for longer."""
        now_s = self._context.now_s()
        if self.blocked:
            self._pressing = self._pressing.add_reading(now_s, {0: at})
            return self._pressing.is_at_rest()
        self._resting = self._resting.add_reading(now_s, {0: at})
        return self._resting.is_at_rest()

    def _update_blocking(self, at: float, goal: float) -> bool:
        """Check whether the jaw does not move although its goal is well ahead."""
        ahead = (goal - at) * math.copysign(1.0, self._goal - at)
        if ahead <= _MIN_LAG_RAD * self._per_horn:
            self._blocking = self._blocking.restarted()
            return False
        self._blocking = self._blocking.add_reading(self._context.now_s(), {0: at})
        return self._blocking.is_at_rest()

    def _with_position(self, joints: Vector, position: float) -> Vector:
        return self._context.index.with_position(joints, self._joint, position)


_DEFAULT_FORCE = 0.3  # fraction of the torque that holds a full cup for an hour without overheating
# Jaws with less force creep so slowly that they look blocked.
_MIN_FORCE = 0.05
# Friction differs by 32 % between servos, and jaws that barely move must arrive as well.
_FRICTION_MARGIN = 1.5
# Jaws that stop within this fraction of their travel from open were too weak to close.
_OPEN_FRACTION = 0.05


def run_gripper(arm: ArmParts, motion: MoveGripper, on_progress: OnProgress | None) -> GraspResult:
    """Move the jaws; see ``Arm.gripper``."""
    context, runner = arm.context, arm.runner
    gripper, fraction = _require_gripper(context), _torque_fraction(context, motion.force)
    goal = _goal_position(context, gripper, motion)  # refuses before any servo is read
    start = context.servos.measure_positions()
    context.check_gripper_path(start, context.index.with_position(start, gripper.joint, goal))
    jaws = GripperMotion(context, runner.allowed_speed("normal"), gripper.joint, goal)
    report_progress = context.progress_reporter(on_progress)
    started_s = context.now_s()
    runner.return_within_limits()

    def start_trajectory(start: Vector) -> OnlineTrajectory:
        context.servos.limit_force(gripper.joint, fraction)  # after torque-on, which resets it
        return jaws.start_trajectory(start)

    def on_cycle(cycle: ControlCycle) -> None:
        jaws.on_cycle(cycle)
        if report_progress:
            report_progress(cycle)

    runner.run(start_trajectory, on_cycle, jaws.speed, compensated=False)
    column = context.index.column(gripper.joint)
    if (goal - float(start[column])) * (gripper.open - gripper.closed) > 0.0:
        arm.scene.release()
    state = context.servos.read_states()[column]
    at = state.position_rad
    reached = jaws.has_arrived(at)
    closed = (at - gripper.open) / (gripper.closed - gripper.open)
    closing = (goal - gripper.open) * (gripper.closed - gripper.open) > 0
    return GraspResult(
        grasped=jaws.blocked and closing and closed > _OPEN_FRACTION and not reached,
        reached=reached,
        position_rad=at,
        width_m=gripper.width_m(at),
        load_percent=state.load_percent,
        force=fraction,
        duration_s=context.now_s() - started_s,
    )


def plan_gripper(context: ArmContext, motion: MoveGripper, start: Vector) -> Vector:
    """Compute all joints (n,) after a gripper motion from ``start`` (n,); nothing moves.

    Raises:
        IkservoError: The errors of ``run_gripper``.
    """
    gripper = _require_gripper(context)
    goal = _goal_position(context, gripper, motion)
    end = context.index.with_position(start, gripper.joint, goal)
    context.check_gripper_path(start, end)
    return end


def _require_gripper(context: ArmContext) -> Gripper:
    if context.model.gripper is None:
        raise IkservoError(
            f'Arm "{context.model.name}" has no gripper.',
            'Its arm file has no joint with role = "gripper".',
        )
    return context.model.gripper


def _goal_position(context: ArmContext, gripper: Gripper, motion: MoveGripper) -> float:
    """Compute the goal of the gripper joint, inside this arm's limits."""
    column = context.index.column(gripper.joint)
    low, high = (float(side[column]) for side in context.limits())
    if motion.width_m is None:
        return min(max(gripper.open if motion.to == "open" else gripper.closed, low), high)
    width_m, known = motion.width_m, gripper.range_m()
    if known is None:
        joint = context.model.joint(gripper.joint)
        middle = joint.joint_map.format(0.5 * (low + high)).strip().rstrip("°").replace(" ", "")
        expected = (
            f"open or close, because the arm file has no widths ([gripper]). Or give the joint's "
            f"position, as in: ikservo joints {gripper.joint}={middle}"
        )
        raise BadValueError("The width", f"{width_m:g} m", expected)
    if not known[0] - 1e-9 <= width_m <= known[1] + 1e-9:
        raise BadValueError("The width", f"{width_m:g} m", f"{known[0]:.3f} to {known[1]:.3f} m")
    return min(max(gripper.position(width_m), low), high)


def _torque_fraction(context: ArmContext, force: float | None) -> float:
    fraction, model = _DEFAULT_FORCE if force is None else force, context.model
    joint = next(joint for joint in model.joints if joint.role == "gripper")
    torque = find_servo_torque(joint.servo.model, model.supply_v)
    friction = torque.friction_share if torque else 0.0
    # The smallest fraction that moves this gripper, in whole percent.
    least = max(_MIN_FORCE, math.ceil(100.0 * _FRICTION_MARGIN * friction) / 100.0)
    if not least <= fraction <= 1.0:
        servo = "" if least == _MIN_FORCE else "; a smaller force does not move its jaws"
        raise BadValueError(
            "The force", f"{fraction:g}", f"a fraction from {least:g} to 1 on this arm{servo}"
        )
    return fraction

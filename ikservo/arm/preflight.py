"""Plans checked before they run: from the start position, within limits, free of collisions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import replace
from math import radians
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arm.arguments import parse_all_positions, parse_number, parse_points
from ikservo.arm.calibrated_arm import MAX_UNCALIBRATED_STEP_RAD
from ikservo.arm.context import ArmContext
from ikservo.arm.drawing import DrawingPlanner, drawing_strokes
from ikservo.arm.motion_options import MotionSettings
from ikservo.arm.plan import (
    RETRACT_POSES,
    MotionPlan,
    PoseWithinLimits,
    clamp_pose,
    clamp_positions,
    via_pose_plan,
)
from ikservo.arm.planner import with_suggested_point
from ikservo.arm.poses import PoseLibrary
from ikservo.errors import BadValueError, OrientationError, RefusedError, UnreachableError
from ikservo.kinematics import finite_array, finite_vector
from ikservo.kinematics.arrays import Vector
from ikservo.motion import ArcPath, arc_about_axis, arc_through_points

__all__ = ["MotionStart", "PlanFrom", "PreflightPlanner"]

# A gripper's goal leads it by more than this at the horn where it presses on something.
_PRESSING_LAG_RAD = 0.05
# Where the whole path to the rest pose is not free, these fractions of it are tried.
_PATH_FRACTIONS = (0.8, 0.6, 0.4, 0.2)

PlanFrom = Callable[[Vector, str], MotionPlan]
"""Makes a plan from a start position (n,), for a speed class."""


class MotionStart(Protocol):
    """Where a motion would start, and how fast it may be; ``MotionRunner`` knows it of now."""

    def start_position(self) -> Vector:
        """Return where it would start (n,), rad or m."""
        ...

    def allowed_speed(self, speed: str) -> str:
        """Return the speed class in which it would run."""
        ...

    def enable(self) -> None:
        """Switch torque on, so that the arm stays there."""
        ...


class PreflightPlanner:
    """Plans the motions of an arm and checks their paths; moves nothing.

    Args:
        context: The arm.
        runner: Knows where a motion would start, and how fast it may be.
        poses: The poses of the arm.
    """

    def __init__(self, context: ArmContext, runner: MotionStart, poses: PoseLibrary) -> None:
        self._context, self._runner, self._poses = context, runner, poses
        self._model, self._planner, self._servos = context.model, context.planner, context.servos

    def plan_to(self, position_m: ArrayLike, tip: MotionSettings) -> MotionPlan:
        """Plan a motion of the tip to a point (3,) [m]; see ``Arm.plan_to``."""

        def plan(point_m: ArrayLike) -> MotionPlan:
            return self.plan_cartesian(
                lambda start, allowed: self._planner.plan_to_point(
                    start, point_m, allowed, tip.stance
                ),
                tip.speed,
            )

        try:
            return plan(position_m)
        except OrientationError:
            raise
        except UnreachableError as error:
            tip_m = self._planner.tip(self._runner.start_position())
            raise with_suggested_point(error, self._context.chain, tip_m, plan) from None

    def plan_line(self, position_m: ArrayLike, tip: MotionSettings) -> MotionPlan:
        """Plan a straight line of the tip to a point (3,) [m]; see ``Arm.plan_line``."""
        return self.plan_through([position_m], replace(tip, line=True))

    def plan_through(self, points_m: Sequence[ArrayLike], tip: MotionSettings) -> MotionPlan:
        """Plan a motion of the tip through points (k, 3) [m]; see ``Arm.plan_through``."""
        blend_m, points_m = parse_number("The blend", tip.blend_m), parse_points(points_m)

        def plan(start: Vector, allowed: str) -> MotionPlan:
            passed = (start, points_m, allowed, blend_m, tip.stance)
            if tip.line:
                return self._planner.plan_linear(*passed, tip.tool_speed_m_s)
            return self._planner.plan_waypoints(*passed)

        if tip.tool_speed_m_s is not None and not tip.line:
            raise BadValueError(
                "The speed of the tool",
                "given for a motion of the joints",
                "a straight line, or the speed of the joints: slow, normal, fast",
            )
        return self.plan_cartesian(plan, tip.speed)

    def plan_arc(
        self, via_m: ArrayLike | None, end_m: ArrayLike | None, tip: MotionSettings
    ) -> MotionPlan:
        """Plan an arc or a circle of the tip; see ``Arm.plan_arc``.

        From a retract pose it would be another arc, so a folded arm is refused.
        """
        arc_from = _arc_from(via_m, end_m, tip)
        self._context.require_zeros()
        start, allowed = self._runner.start_position(), self._runner.allowed_speed(tip.speed)
        plan = self._planner.plan_path(start, arc_from, allowed, tip.stance, tip.tool_speed_m_s)
        plan = self._check_clear(plan, tip.speed)
        return self._make_replannable(plan, lambda: self.plan_arc(via_m, end_m, tip))

    def plan_drawing(self, strokes_m: object, tip: MotionSettings) -> MotionPlan:
        """Plan strokes of the tip, each (k, 3) [m]; see ``Arm.plan_drawing``."""
        strokes = drawing_strokes(parse_points(strokes_m))
        lift_m = parse_number("The lift of the tool", tip.lift_m)
        drawing = DrawingPlanner(self._planner, strokes, lift_m, tip.stance, tip.tool_speed_m_s)
        return self.plan_cartesian(drawing.plan, tip.speed)

    def plan_cartesian(self, planning: PlanFrom, speed: str) -> MotionPlan:
        """Plan a motion of the tip from the start position and check its path.

        A folded arm touches itself on nearly every path: it leaves that contact first.

        Raises:
            RefusedError: The arm would touch itself, the table or a box.
            CalibrationError: The arm is not calibrated.
        """
        self._context.require_zeros()
        plan = self._plan_clear_or_via(planning, self._runner.start_position(), speed)
        return self._make_replannable(plan, lambda: self.plan_cartesian(planning, speed))

    def plan_joints(self, positions: Mapping[str, float] | ArrayLike, speed: str) -> MotionPlan:
        """Plan a motion of some joints; see ``Arm.plan_joints``."""
        start, zeros = self._runner.start_position(), self._context.zeros
        goals = parse_all_positions(positions, self._servos.names)
        plan = self._planner.plan_to_joints(start, goals, self._runner.allowed_speed(speed))
        zeros.check_small_steps(self._model.name, start, plan.goal, self._max_steps())
        try:
            self._servos.check_goal(plan.goal, start)
        except RefusedError as error:
            error.python_hint = self._ask_about_degrees(goals)
            raise
        if zeros.are_known and set(self._context.chain.names) <= set(goals):  # the whole arm
            plan = self._plan_clear_or_via(
                lambda at, allowed: self._planner.plan_to_joints(at, goals, allowed), start, speed
            )
        else:
            plan = self._check_clear(plan, speed)
        return self._make_replannable(plan, lambda: self.plan_joints(positions, speed))

    def _ask_about_degrees(self, goals: Mapping[str, float]) -> str:
        """Return a hint where goals in radians are outside the limits and as degrees are inside."""
        fences = {fence.joint: fence for fence in self._servos.fences}
        for name, goal in goals.items():
            lower, upper = fences[name].limits.lower.value, fences[name].limits.upper.value
            turned = fences[name].limits.unit == "rad" and not lower <= goal <= upper
            if turned and lower <= radians(goal) <= upper:
                meant = f"math.radians({goal:g}), which is {radians(goal):.4g}"
                return f"Positions are radians. Did you mean {goal:g} degrees? Give {meant}."
        return ""

    def pose_within_limits(self, pose: str, start: Vector | None = None) -> PoseWithinLimits:
        """Clamp a named pose to this arm's limits; see ``Arm.pose_within_limits``."""
        if start is None and pose == "rest":
            return self.rest_pose()
        positions = self._poses.get_pose(pose)
        if start is None:
            start = self._runner.start_position()
        else:
            start = finite_array(start, (len(self._servos.names),), "The start")
        return clamp_pose(pose, positions, self._servos.fences, start)

    def clearance_m(self, positions: Mapping[str, float] | ArrayLike) -> float:
        """Return the smallest distance of the body [m]; see ``Arm.clearance_m``."""
        names, index = self._servos.names, self._context.index
        by_name = parse_all_positions(positions, names)
        complete = len(by_name) == len(names)
        joints = np.zeros(len(names)) if complete else self._servos.measure_positions()
        for name, position in by_name.items():
            joints[index.column(name)] = position
        return self._context.clearance_m(finite_vector(joints, len(names), "The joints"))

    def plan_rest(self) -> MotionPlan:
        """Plan the slow motion to the rest pose; see ``Arm.plan_rest``."""
        rest = self.rest_pose().positions
        try:
            return self.plan_joints(rest, "slow")
        except RefusedError:
            found = self._plan_via_pose(
                lambda start, allowed: self._planner.plan_to_joints(start, rest, allowed),
                self._runner.start_position(),
                "slow",
                "slow",
            )
            if found is None:
                raise
        return self._make_replannable(found, self.plan_rest)

    def plan_lowering(self) -> MotionPlan:
        """Plan the slow motion to the rest pose, or as much of it as is free.

        Raises:
            CalibrationError: The arm is not calibrated.
            RefusedError: No part of it is free.
            ServoAlarmError: A servo reports what would end the motion at once.
        """
        with self._servos.tolerate_heat():
            self._servos.check_health()
        try:
            return self.plan_rest()
        except RefusedError:
            rest = self.rest_pose().positions
            start = self._context.index.by_name(self._runner.start_position())
            for fraction in _PATH_FRACTIONS:
                part = {n: start[n] + fraction * (rest[n] - start[n]) for n in rest}
                with suppress(RefusedError):
                    return self.plan_joints(part, "slow")
            raise

    def rest_pose(self) -> PoseWithinLimits:
        """Return the rest pose within the limits, without a gripper that presses on something."""
        rest, gripper = dict(self._model.pose("rest")), self._model.gripper
        start = self._runner.start_position()
        if gripper is not None and self._is_pressing(gripper.joint, start):
            del rest[gripper.joint]
        return clamp_pose("rest", rest, self._servos.fences, start)

    def plan_from_held(self, planning: Callable[[], MotionPlan]) -> MotionPlan:
        """Plan from where the arm holds: a limp one may sink before its torque is on."""
        plan = planning()
        if self._servos.torque.is_on:
            return plan
        self._runner.enable()
        return plan if np.array_equal(plan.start, self._servos.reference()) else planning()

    def _is_pressing(self, joint: str, start: Vector) -> bool:
        column = self._context.index.column(joint)
        joint_map = self._servos.fences[column].joint_map
        lag = abs(start[column] - self._servos.measure_positions()[column])
        return lag / joint_map.unit_per_horn_rad > _PRESSING_LAG_RAD

    def _make_replannable(self, plan: MotionPlan, again: Callable[[], MotionPlan]) -> MotionPlan:
        """Return a plan that can be made again, if the arm may sink until its torque is on."""
        if self._servos.torque.is_on:
            return plan

        def plan_again(context: object) -> MotionPlan | None:
            return again() if context is self._context else None

        return replace(plan, again=plan_again)

    def _max_steps(self) -> dict[str, float]:
        """Return the longest motion of each joint of an uncalibrated arm, rad or m."""
        joints = [self._model.joint(name) for name in self._servos.names]
        return {
            joint.name: MAX_UNCALIBRATED_STEP_RAD * joint.travel_per_turn / math.tau
            for joint in joints
        }

    def _plan_clear_or_via(self, planning: PlanFrom, start: Vector, speed: str) -> MotionPlan:
        """Return a plan whose path is free: direct, or one that leaves a contact first.

        Raises:
            RefusedError: The arm would touch itself, the table or a box.
        """
        allowed = self._runner.allowed_speed(speed)
        try:
            return self._check_clear(planning(start, allowed), speed)
        except RefusedError:
            if not self._context.is_in_contact(start):
                raise
            found = self._plan_via_pose(planning, start, allowed, speed)
            if found is None:
                raise
            return found

    def _plan_via_pose(
        self, planning: PlanFrom, start: Vector, allowed: str, requested: str
    ) -> MotionPlan | None:
        """Return a plan that leaves a contact first; None where there is no free path."""
        for pose, first in self._ways_out(start, allowed):
            with suppress(RefusedError):
                then = planning(first.goal, allowed)
                return self._check_clear(self._join(first, then, pose), requested)
        return None

    def _ways_out(self, start: Vector, allowed: str) -> Iterator[tuple[str, MotionPlan]]:
        """Yield motions out of a contact, and the retract poses where they end ("" for none).

        The first moves just as far as the arm needs to touch nothing.
        """
        free = self._context.nearest_free_joints(start)
        out = free is not None and self._planner.plan_to_joints(
            start, self._context.index.by_name(free), allowed
        )
        if out:
            yield "", out
        for pose in RETRACT_POSES:
            yield pose, self._plan_to_pose(pose, start, allowed)
            if out:
                then = self._plan_to_pose(pose, out.goal, allowed)
                yield pose, self._join(out, then, "")

    def _plan_to_pose(self, pose: str, start: Vector, allowed: str) -> MotionPlan:
        positions = self._model.pose(pose)
        named = {name: positions[name] for name in self._context.chain.names}
        inside = clamp_positions(named, self._servos.fences, start, max_rad=math.inf)
        return self._planner.plan_to_joints(start, inside.positions, allowed)

    def _join(self, first: MotionPlan, then: MotionPlan, pose: str) -> MotionPlan:
        change_rad = self._planner.rotation_between(first.start, then.goal)
        return via_pose_plan(first, then, pose, change_rad)

    def _check_clear(self, plan: MotionPlan, requested: str) -> MotionPlan:
        """Return the plan if its path is free, with whether it is slower than requested."""
        self._context.check_streamed_path(plan.trajectory, plan.speed)
        return replace(plan, speed_reduced=plan.speed != requested)


def _arc_from(
    via_m: ArrayLike | None, end_m: ArrayLike | None, tip: MotionSettings
) -> Callable[[Vector], ArcPath]:
    """Return a function that makes the requested arc from the present tip (3,) [m].

    Raises:
        BadValueError: Neither a via point with an end nor a centre is given, or both.
    """
    if tip.center_m is not None and via_m is None and end_m is None and not tip.full_circle:
        center_m, angle_rad = tip.center_m, parse_number("The angle of the arc", tip.angle_rad)
        return lambda tip_m: arc_about_axis(tip_m, center_m, tip.normal, angle_rad)
    if tip.center_m is None and via_m is not None and end_m is not None:
        closed = tip.full_circle
        return lambda tip_m: arc_through_points(tip_m, via_m, end_m, full_circle=closed)
    given = {"a via point": via_m, "an end": end_m, "a centre": tip.center_m}
    names = [name for name, value in given.items() if value is not None]
    raise BadValueError(
        "The arc",
        f"given by {' and '.join(names) or 'nothing'}",
        "a via point and an end, or a centre alone",
    )

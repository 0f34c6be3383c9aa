"""Plans checked before they run: from the measured position, within limits, free of collisions."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arm.arguments import parse_all_positions
from ikservo.arm.motion_runner import Running
from ikservo.arm.plan import (
    RETRACT_POSES,
    Inside,
    MotionPlan,
    brought_inside,
    has_moved,
    via_pose_plan,
)
from ikservo.arm.planner import with_suggested_point
from ikservo.arm.tool_orientation import KEEP_BEST_EFFORT, ToolOrientation, check_orientation
from ikservo.arm.zeros import MAX_UNCALIBRATED_STEP_RAD
from ikservo.errors import OrientationError, RefusedError, UnreachableError
from ikservo.kinematics.arrays import Vector

__all__ = ["Foreseeing"]

_CONTACT_M = 0.005
# A gripper's goal leads it by more than this at the horn where something is between its jaws.
_PRESSING_LAG_RAD = 0.05
# Where the whole way down is not free, these shares of it are tried.
_PATH_FRACTIONS = (0.8, 0.6, 0.4, 0.2)


class Foreseeing(Running):
    """What ``Arm`` finds out before it moves; nothing here moves."""

    def plan_to(
        self,
        position_m: ArrayLike,
        *,
        speed: str = "normal",
        stance: ToolOrientation = KEEP_BEST_EFFORT,
        orientation: ArrayLike | None = None,
    ) -> MotionPlan:
        """Find joints that bring the tip to a point and the motion that takes them there.

        Args:
            position_m: The point (3,), metres, in the arm's base frame.
            speed: slow, normal or fast; the first motion after torque comes on is slow.
            stance: How the tool shall stand there; if nothing is asked, as well as the arm can
                keep it.
            orientation: The whole orientation R_base_tip (3, 3), instead of a stance.

        Raises:
            UnreachableError: No joints inside the limits reach it; carries the nearest point.
            OrientationError: The tool cannot stand there as asked.
            BadValueError: No three finite numbers.
            RefusedError: On the way the arm would touch itself, the table or a box.
            CalibrationError: Nobody knows where the arm's zeros are.
        """
        asked = check_orientation(stance, orientation)

        def plan(point_m: ArrayLike) -> MotionPlan:
            return self.plan_cartesian(
                lambda here, pace: self._planner.plan_to_point(here, point_m, pace, asked), speed
            )

        try:
            return plan(position_m)
        except OrientationError:
            raise
        except UnreachableError as error:
            tip_m = self._planner.tip(self._start_joints())
            raise with_suggested_point(error, self.chain, tip_m, plan) from None

    def plan_cartesian(
        self, planning: Callable[[Vector, str], MotionPlan], speed: str
    ) -> MotionPlan:
        """Make a plan of the tip from where the arm is, at the speed it may go; look at its way.

        An arm that lies folded touches itself on nearly every way: it rises first.

        Raises:
            RefusedError: On the way the arm would touch itself, the table or a box.
            CalibrationError: Nobody knows where the arm's zeros are.
        """
        self.zeros.require_known(self.model.name)
        plan = self._plan_clear_or_via(planning, self._start_joints(), speed)
        return self._make_replannable(plan, lambda: self.plan_cartesian(planning, speed))

    def plan_joints(
        self, positions: Mapping[str, float] | ArrayLike, *, speed: str = "normal"
    ) -> MotionPlan:
        """Plan a motion of some joints, each to its position in rad (m for a prismatic one).

        Raises:
            UnknownNameError: No such joint, or no such speed.
            BadValueError: A position is not finite, or no joint is named.
            RefusedError: A position lies outside the joint's limits, or on the way the arm
                would touch itself, the table or a box.
            CalibrationError: Nobody knows where the arm's zeros are, and the way is long.
        """
        here, goals = self._start_joints(), parse_all_positions(positions, self._servos.names)
        plan = self._planner.plan_to_joints(here, goals, self._allowed_speed(speed))
        self.zeros.check_small_steps(self.model.name, here, plan.goal, self._max_steps())
        self._servos.check_goal(plan.goal, here)
        if self.zeros.are_known and set(self.chain.names) <= set(goals):  # a pose of the whole arm
            plan = self._plan_clear_or_via(
                lambda start, pace: self._planner.plan_to_joints(start, goals, pace), here, speed
            )
        else:
            plan = self._check_clear(plan, speed)
        return self._make_replannable(plan, lambda: self.plan_joints(positions, speed=speed))

    def pose_within_limits(self, pose: str) -> Inside:
        """Return a named pose as this arm can go to it: its limits may be narrower than the pose.

        The rest pose is brought inside them whatever they are: an arm must always be able to come
        down. Another pose is, where its joints lie on their end stops, just beyond a limit.

        Raises:
            UnknownNameError: There is no such pose.
        """
        if pose == "rest":
            return self._rest_pose()
        return brought_inside(self.poses.get_pose(pose), self._servos.fences, self._start_joints())

    def plan_rest(self) -> MotionPlan:
        """Plan the slow way to the rest pose; by another pose where that is not free.

        Raises:
            CalibrationError: Nobody knows where the rest pose is.
            RefusedError: No way there is free.
        """
        rest = self._rest_pose().positions
        try:
            return self.plan_joints(rest, speed="slow")
        except RefusedError:
            found = self._plan_via_pose(
                lambda here, pace: self._planner.plan_to_joints(here, rest, pace),
                self._start_joints(), "slow", "slow",
            )  # fmt: skip
            if found is None:
                raise
        return self._make_replannable(found, self.plan_rest)

    def plan_lowering(self) -> MotionPlan:
        """Plan the slow way to the rest pose, or as much of it as is free.

        Raises:
            CalibrationError: Nobody knows where the rest pose is.
            RefusedError: No part of it is free.
        """
        try:
            return self.plan_rest()
        except RefusedError:
            rest, here = self._rest_pose().positions, self._start_joints()
            for share in _PATH_FRACTIONS:
                with suppress(RefusedError):
                    return self.plan_joints(
                        self._interpolate_positions(here, rest, share), speed="slow"
                    )
            raise

    def _interpolate_positions(
        self, here: Vector, goal: Mapping[str, float], share: float
    ) -> dict[str, float]:
        starts = {name: float(here[self._planner.joint_index(name)]) for name in goal}
        return {name: at + share * (goal[name] - at) for name, at in starts.items()}

    def _rest_pose(self) -> Inside:
        """Return the rest pose inside the limits; a gripper that presses on something is left."""
        rest, gripper, here = (
            dict(self.model.pose("rest")),
            self.model.gripper,
            self._start_joints(),
        )
        if gripper is not None:
            column = self._planner.joint_index(gripper.joint)
            joint_map = self._servos.fences[column].joint_map
            ahead = abs(here[column] - self._servos.measure_positions()[column])
            if ahead / joint_map.unit_per_horn_rad > _PRESSING_LAG_RAD:
                del rest[gripper.joint]
        return brought_inside(rest, self._servos.fences, here, most_rad=math.inf)

    def _plan_from_held(self, planning: Callable[[], MotionPlan]) -> MotionPlan:
        """Return a plan from where the arm holds: a limp one may sink before its torque is on."""
        plan = planning()
        if self._servos.torque.is_on:
            return plan
        self.enable()
        return plan if np.array_equal(plan.start, self._servos.goals()) else planning()

    def _make_replannable(self, plan: MotionPlan, again: Callable[[], MotionPlan]) -> MotionPlan:
        """Return a plan that can be made anew, if the arm may sink until its torque is on."""
        if self._servos.torque.is_on:
            return plan

        def made_again(arm: object) -> MotionPlan | None:
            return again() if arm is self else None

        return replace(plan, again=made_again)

    def _replan_if_moved(self, plan: MotionPlan) -> MotionPlan:
        """Return a plan, made anew where a limp arm has sunk since; its servos hold by now.

        Raises:
            RefusedError: No way is free from there.
        """
        goals, paces = self._servos.goals(), self._planner.motion_limits(plan.speed)
        if plan.again is None or plan.names != self._servos.names:
            return plan
        return plan.again(self) or plan if has_moved(plan, goals, paces) else plan

    def _max_steps(self) -> dict[str, float]:
        """Return the longest way at once for each joint whose zero nobody knows, rad or m."""
        turns = {joint.name: joint.travel_per_turn / math.tau for joint in self.model.joints}
        return {name: MAX_UNCALIBRATED_STEP_RAD * turns[name] for name in self._servos.names}

    def _plan_clear_or_via(
        self, planning: Callable[[Vector, str], MotionPlan], here: Vector, speed: str
    ) -> MotionPlan:
        """Return a plan whose way is free: straight, or for a folded arm by another pose.

        Raises:
            RefusedError: On the way the arm would touch itself, the table or a box.
        """
        pace = self._allowed_speed(speed)
        try:
            return self._check_clear(planning(here, pace), speed)
        except RefusedError:
            found = (
                self._plan_via_pose(planning, here, pace, speed)
                if self._is_in_contact(here)
                else None
            )
            if found is None:
                raise
            return found

    def _is_in_contact(self, here: Vector) -> bool:
        """Return whether the arm lies on itself, on the table or on a box, or nearly so."""
        if self._space is None:
            return False
        return float(self._space.distances([self.workings.body_joints(here)]).min()) < _CONTACT_M

    def _plan_via_pose(
        self, planning: Callable[[Vector, str], MotionPlan], here: Vector, pace: str, asked: str
    ) -> MotionPlan | None:
        """Return a plan by way of a pose where the arm stands free; None where there is no way."""
        for pose in RETRACT_POSES:
            named = {n: q for n, q in self.model.pose(pose).items() if n in self.chain.names}
            inside = brought_inside(named, self._servos.fences, here, most_rad=math.inf)
            first = self._planner.plan_to_joints(here, inside.positions, pace)
            with suppress(RefusedError):
                return self._check_clear(
                    via_pose_plan(first, planning(first.goal, pace), pose), asked
                )
        return None

    def _check_clear(self, plan: MotionPlan, asked: str) -> MotionPlan:
        """Return the plan, if the body's way to its goal is free."""
        self.workings.check_streamed_path(plan.course, plan.speed)
        return replace(plan, speed_reduced=plan.speed != asked)

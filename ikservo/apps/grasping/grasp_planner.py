"""Find a grasp that the arm can reach, and plan all of its motions before the first one."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import reduce
from time import perf_counter
from typing import Any

import numpy as np

from ikservo.apps.grasping.jaws import find_jaws
from ikservo.arm.gripper import plan_gripper
from ikservo.errors import OrientationError, RefusedError, UnreachableError, format_point
from ikservo.ik import Target
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import make_pose
from ikservo.model.tool import tool_frame
from ikservo.motion import ConcatenatedTrajectory, JointMove
from ikservo.planning.context import ArmContext
from ikservo.planning.motion_plan import MotionPlan
from ikservo.planning.motions import MotionValue, MoveGripper, MoveLine, MoveTo
from ikservo.planning.poses import PoseLibrary
from ikservo.planning.preflight_planner import PlannedStart, PreflightPlanner
from ikservo.planning.tool_orientation import ToolOrientation, solve_with_orientation

_FROM_ABOVE_RAD = math.radians(-40.0)  # a steeper tool comes from above, if it can
_APPROACHES_M = (0.08, 0.05)
_LOOSE_RAD = math.radians(30.0)  # tolerance of the tool's orientation before and after a grasp
_LOWER_M = 0.002  # the arm may end this much lower, and must still be free to leave
_THINK_S, _MOST_S = 1.0, 20.0  # for a path around things, as there are other grasps; for all
_ROLLS_RAD = np.radians(np.arange(-180.0, 180.0, 2.0))
_UP = np.array([0.0, 0.0, 1.0])

Motions = Sequence[MotionValue[Any]]
Stance = tuple[ToolOrientation, Vector]
"""The orientation of the tool, and the point (3,) of the tip that goes to what is gripped."""
Arrange = Callable[[MoveTo, MoveLine, MoveLine], Motions]
"""Puts the motions to a point before a thing, to it and away among those of the jaws."""


class GraspPlanner:
    """Plans picks and places from all joints (n,); nothing moves, and no servo is read."""

    def __init__(self, context: ArmContext, start: Vector, speed: str) -> None:
        context.require_zeros()
        self._context, self._start, self._speed = context, start, speed
        self.tool, self.jaws = tool_frame(context.model), find_jaws(context.model)

    def plan(
        self,
        middle_m: Vector,
        raises_m: Sequence[float],
        stances: Iterable[Stance],
        arrange: Arrange,
        held: float,
    ) -> tuple[Motions, MotionPlan]:
        """Return the motions of the first grasp that is possible, and one plan of them all.

        Args:
            middle_m: The middle (3,) of what is gripped.
            raises_m: Heights above it at which it may be gripped, the best first.
            stances: How it may be gripped, the best first.
            arrange: Arranges the motions.
            held: The position of the gripper's joint when it holds it.

        Raises:
            RefusedError: The point is below the table, or no grasp is possible.
            UnreachableError: The point is out of reach.
        """
        at, reason = format_point(middle_m.tolist()), "The gripper cannot be turned to it there."
        if middle_m[2] < (self._context.model.floor_m or 0.0):
            raise RefusedError(f"{at} is below the table.", "Nothing moves. Choose another point.")
        self._context.planner.reach(self._start, middle_m)
        until_s = perf_counter() + _MOST_S
        for stance, grip_m in stances:
            for raise_m in raises_m:
                if perf_counter() > until_s:
                    break
                T = self.tip_at(middle_m + raise_m * _UP, stance, grip_m)
                if T is None:
                    break
                lower = self._approaches(make_pose(-_LOWER_M * _UP, np.eye(3)) @ T, stance, arrange)
                for below, motions in zip(lower, self._approaches(T, stance, arrange), strict=True):
                    try:
                        self._plan_all(below, held)
                        return motions, self._plan_all(motions, held)
                    except (RefusedError, UnreachableError) as error:
                        reason = error.message
        raise RefusedError(
            f"{self._context.model.name} cannot grip or put down anything at {at}: {reason}",
            "Nothing moves. Choose another point, or move what is in the way.",
        )

    def tip_at(self, point_m: Vector, stance: ToolOrientation, grip_m: Vector) -> Matrix | None:
        """Return the pose of the tip (4, 4) that has its point ``grip_m`` at another one, or None.

        The orientation depends on where the tip is, so that it is solved again.
        """
        chain, tip_m, R = self._context.chain, point_m, np.eye(3)
        q = self._context.index.chain_joints(self._start)
        for _ in range(3 if grip_m.any() else 1):
            try:
                found = solve_with_orientation(chain, self.tool, Target(tip_m), stance, q).solution
            except OrientationError:
                return None
            if not found.reached:
                return None
            q, R = found.q, chain.forward(found.q)[:3, :3]
            tip_m = point_m - R @ grip_m
        return make_pose(tip_m, R)

    def level_rolls(
        self, R: Matrix, pitch_rad: float, side_rad: float | None, askew_rad: float
    ) -> list[float]:
        """Return the rolls of a tool (3, 3) at which its jaws are level and close on a side."""
        heading_rad = self.tool.heading_rad(R) or 0.0
        turned = [self.tool.rotation(heading_rad, pitch_rad, roll) for roll in _ROLLS_RAD]
        x, y, z = (np.array(turned) @ self.jaws.axis).T
        aside = 0.0 if side_rad is None else np.abs(np.sin(np.arctan2(y, x) - side_rad))
        askew = np.maximum(np.abs(z), aside)
        best = int(np.argmin(askew))
        both = _ROLLS_RAD[[best, best - len(_ROLLS_RAD) // 2]].tolist()
        return sorted(both, key=abs) if askew[best] < math.sin(askew_rad) else []

    def _approaches(self, T: Matrix, stance: ToolOrientation, arrange: Arrange) -> list[Motions]:
        """Return the motions from above, and back along the tool, to a pose of the tip (4, 4)."""
        loose, speed, at_m = replace(stance, within_rad=_LOOSE_RAD), self._speed, T[:3, 3]
        back, is_steep = -T[:3, :3] @ self.tool.approach_axis, self.tool.pitch_rad(T[:3, :3])
        ways = [_UP, back] if is_steep < _FROM_ABOVE_RAD else [back]
        return [
            arrange(
                MoveTo(above_m, speed=speed, stance=loose, think_s=_THINK_S),
                MoveLine(at_m, speed="slow", stance=stance),
                MoveLine(above_m, speed=speed, stance=loose),
            )
            for above_m in (at_m + length_m * way for way in ways for length_m in _APPROACHES_M)
        ]

    def _plan_all(self, motions: Motions, held: float) -> MotionPlan:
        """Plan motions one after the other, as one plan; the jaws close to ``held``."""
        context, start, plans = self._context, self._start, list[MotionPlan]()
        poses = PoseLibrary(context.model, context.serial_number)
        for motion in motions:
            if isinstance(motion, MoveGripper):
                end = plan_gripper(context, motion, start)
                if motion.to == "close":
                    end[context.index.outside_chain()] = held
                move = JointMove(start, end, context.planner.motion_limits(self._speed))
                tip_m, lasts_s = context.planner.tip(start), move.duration_s
                plans.append(MotionPlan(start, end, move, tip_m, 0.0, lasts_s, self._speed))
            else:
                plans.append(PreflightPlanner(context, PlannedStart(start), poses).plan(motion))
            start = plans[-1].goal
        return replace(
            plans[-1],
            start=self._start,
            trajectory=reduce(ConcatenatedTrajectory, [each.trajectory for each in plans]),
            path_m=sum(each.path_m for each in plans),
            duration_s=sum(each.duration_s for each in plans),
        )

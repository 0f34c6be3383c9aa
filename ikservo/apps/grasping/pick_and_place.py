"""``arm.pick`` and ``arm.place``: all motions are planned before the first motion begins."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import KW_ONLY, dataclass, replace
from functools import partial, reduce
from itertools import product
from time import perf_counter
from typing import Annotated, Any, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ikservo.apps.grasping.jaws import find_jaws
from ikservo.arm.arm_protocol import ArmParts, OpenArm
from ikservo.arm.gripper import plan_gripper
from ikservo.arm.own_motion import OwnMotion
from ikservo.arm.plan_execution import execute
from ikservo.arm.run_by_kind import run_motion
from ikservo.errors import (
    BadValueError,
    NotSettledError,
    OrientationError,
    RefusedError,
    UnreachableError,
    format_point,
)
from ikservo.ik import Target
from ikservo.ik.problem import check_position
from ikservo.kinematics.arrays import Matrix, Vector, finite_vector
from ikservo.kinematics.packed import IS_CYLINDER, ROUNDING
from ikservo.kinematics.se3 import make_pose, rotation_rpy
from ikservo.model.scene_file import KeepOutShape
from ikservo.model.tool import tool_frame
from ikservo.motion import ConcatenatedTrajectory, JointMove, Trajectory, TrajectoryPoint
from ikservo.planning.context import ArmContext
from ikservo.planning.motion_plan import MotionPlan, has_moved
from ikservo.planning.motions import MotionValue, MoveGripper, MoveLine, MoveTo, Speed
from ikservo.planning.poses import PoseLibrary
from ikservo.planning.preflight_planner import PlannedStart, PreflightPlanner
from ikservo.planning.reports import GraspResult, OnProgress
from ikservo.planning.tool_orientation import ToolOrientation, solve_with_orientation

_PITCHES_RAD = np.radians([-86.0, -80.0, -75.0, -60.0, -45.0, -30.0, -15.0, 0.0])  # the best first
_ROLLS_RAD = np.radians(np.arange(-180.0, 180.0, 2.0))  # of the tool, that are tried
_FROM_ABOVE_RAD = math.radians(-40.0)  # a steeper tool comes from above, if it can
_MAX_SKEW = math.sin(math.radians(15.0))  # between the jaws and the horizontal, or the thing
_LOOSE_RAD = math.radians(30.0)  # tolerance of the tool's orientation without a thing
_UPRIGHT_RAD = math.radians(12.0)  # tolerance with a thing in the jaws
_UPRIGHT_COSINE = 0.999  # of the tilt of a box that counts as upright
_CLEARANCE_M = 0.006  # between the thing and each open jaw, if there is room
_MIN_CLEARANCE_M = 0.001
_UNKNOWN_WIDTH_M = 0.03  # of a thing whose size was not given
_TOP_M = 0.004  # part of a thing above the tip
_GRIPPED_M = 0.008  # part of a thing between jaws that reach beyond the tip
_APPROACHES_M = (0.08, 0.05)  # lengths of the straight approach, the best first
_LOWER_M = 0.001  # jaws that hold another width than planned may reach this much lower
_RAISE_STEP_M, _MOST_RAISE_M = 0.0015, 0.015  # of the tip above the middle, the best first
_SUNK_M = 0.002  # error of a point on the table that is not refused
_DROPS_M = (0.002, 0.006, 0.01, 0.015, 0.02)  # heights from which a thing is let go
_OPENED = 0.1  # of the jaws' travel; they have then let go of what was between them
_THINK_S = 1.0  # for a path around things; another grasp may need none
_SEARCH_S = 40.0  # for all grasps
_UP = np.array([0.0, 0.0, 1.0])

Motions = Sequence[MotionValue[Any]]
Steps = Sequence[MotionPlan | MoveGripper]  # one after the other
Planned = tuple[Steps, MotionPlan]  # and one plan of all steps
Stance = tuple[ToolOrientation, Vector]  # and the point (3,) of the tip that goes to the thing


def _parse_size(value: object) -> tuple[float, ...]:
    size_m = finite_vector(cast("ArrayLike", value), 3, "The size").tolist()
    if min(size_m) <= 0.0:
        raise BadValueError("The size", str(size_m), "three lengths above 0 m")
    return tuple(size_m)


def _parse_point(value: object) -> tuple[float, ...]:
    return tuple(check_position(cast("ArrayLike", value), "The point").tolist())


def _parse_yaw(value: object) -> float:
    return float(finite_vector([cast("float", value)], 1, "The yaw")[0])


class Grip:
    """How an arm holds the thing that it picked up: the tip's pose (4, 4) in the thing's frame."""

    def __init__(self, _arm: object) -> None:
        self.T_thing_tip: Matrix | None = None
        self.height_m = self.jaws_at = 0.0

    def is_held_at(self, context: ArmContext, joints: Vector) -> bool:
        """Return whether a thing is gripped and the jaws have not opened since; joints are (n,)."""
        gripper = context.model.gripper
        if self.T_thing_tip is None or gripper is None:
            return False
        at, travel = joints[context.index.column(gripper.joint)], gripper.open - gripper.closed
        return bool((at - self.jaws_at) / travel < _OPENED)


@dataclass(frozen=True)
class Pick(OwnMotion[GraspResult]):
    """Pick up a thing: the jaws open, move to the thing, close on it and lift it.

    Attributes:
        middle_m: The middle (3,) of the thing, metres, base frame.
        size_m: The length, width and height (3,) of the thing; None: 3 cm, or the least width that
            the jaws hold.
        yaw_rad: The direction of the thing's length, from x towards y.
        speed: See ``MoveTo``.
    """

    middle_m: Annotated[Any, _parse_point]
    _: KW_ONLY
    size_m: Annotated[Any, _parse_size] = None
    yaw_rad: Annotated[float, _parse_yaw] = 0.0
    speed: Speed = "normal"

    def plan(self, context: ArmContext, start: Vector, _grip: Grip | None = None) -> Planned:
        """Plan from the joints ``start`` (n,): open, move above, down, close, up, close again.

        Raises:
            RefusedError: The thing cannot be picked up; the message says why.
            UnreachableError: The point is out of reach.
        """
        planner, middle_m = _GraspPlanner(context, start, self.speed), np.array(self.middle_m)
        most_m, least_m = planner.jaws.most_m, planner.jaws.least_m
        held_m = least_m and least_m + 2.0 * _MIN_CLEARANCE_M, most_m - 2.0 * _MIN_CLEARANCE_M
        wide_m = max(_UNKNOWN_WIDTH_M, held_m[0])
        length_m, width_m, height_m = self.size_m or (wide_m, wide_m, _UNKNOWN_WIDTH_M)
        most_raise_m = min(max(height_m / 2.0 - _TOP_M, 0.0), _MOST_RAISE_M)
        most_raise_m += max(planner.jaws.beyond_m - (_GRIPPED_M - _TOP_M), 0.0)
        raises_m = [*np.arange(0.0, most_raise_m, _RAISE_STEP_M).tolist(), most_raise_m]
        across: list[tuple[float, float | None]]
        across = sorted([(width_m, self.yaw_rad + math.pi / 2.0), (length_m, self.yaw_rad)])
        sides = [each for each in across if held_m[0] <= each[0] <= held_m[1]]
        if not sides:
            wide = " by ".join(dict.fromkeys(f"{1000.0 * each:.0f}" for each, _ in across))
            held = " to ".join(f"{1000.0 * each:.0f}" for each in held_m)
            text = f"The thing is {wide} mm wide, but the jaws hold only {held} mm."
            raise RefusedError(text, "Nothing moved. Choose another object.")
        if len(sides) == 2:  # Jaws that cannot be turned to a thing turn the thing.
            sides.append((math.hypot(length_m, width_m), None))

        def stances() -> Iterator[Stance]:
            for pitch_rad in _PITCHES_RAD.tolist():
                T = planner.tip_at(middle_m, ToolOrientation(pitch_rad), np.zeros(3))
                for across_m, side_rad in sides:
                    spare_m = min(2.0 * _CLEARANCE_M, most_m - across_m)
                    if T is not None and spare_m >= 2.0 * _MIN_CLEARANCE_M:
                        grip_m = planner.jaws.at_width(across_m + spare_m)[1]
                        for roll_rad in planner.level_rolls(T[:3, :3], pitch_rad, side_rad):
                            yield ToolOrientation(pitch_rad, roll_rad), grip_m

        kinds = ["open", "to", "down", "close", "away", "close"]
        closed = planner.jaws.at_width(sides[0][0])[0]
        return planner.plan(middle_m, raises_m, stances(), kinds, closed)

    def end(self, context: ArmContext, start: Vector) -> Vector:
        """Compute the joints (n,) after the motion from ``start`` (n,); nothing moves."""
        return self.plan(context, start)[1].goal

    def run(self, arm: ArmParts, on_progress: OnProgress | None, steps: Steps = ()) -> GraspResult:
        """Pick up the thing, following a plan's ``steps``; reopen the jaws if they grip nothing."""
        grip, steps = _grip_of(arm), steps or _plan_now(self, arm)
        if not _run(arm, steps[:1], on_progress).reached:
            raise RefusedError("The jaws did not open.", "Remove what is between them.")
        grip.T_thing_tip = None
        report = _run(arm, steps[1:4], on_progress)
        if not report.grasped:
            _run(arm, (steps[0], steps[4]), on_progress)
        else:  # kept before it is lifted, because a stop may end the motion
            T_base_tip = arm.context.planner.tip_pose(arm.context.servos.measure_positions())
            T = make_pose(np.array(self.middle_m), rotation_rpy(0.0, 0.0, self.yaw_rad))
            grip.jaws_at = report.position_rad
            grip.T_thing_tip = np.linalg.inv(T) @ T_base_tip
            grip.height_m = self.size_m[2] if self.size_m else _UNKNOWN_WIDTH_M
            report = _run(arm, steps[4:], on_progress)
            if report.grasped:
                return report
            grip.T_thing_tip = None
        at = format_point(self.middle_m)
        hint = "Check where it is, then try again."
        raise RefusedError(f"The gripper found nothing at {at}, or dropped it.", hint)

    def __str__(self) -> str:
        return f"pick up at {format_point(self.middle_m)}"


@dataclass(frozen=True)
class Place(OwnMotion[GraspResult]):
    """Put down the held thing: the arm lowers it, opens the jaws and withdraws.

    Attributes:
        middle_m: The target (3,) for the middle of the held thing, metres, base frame.
        speed: See ``MoveTo``.
    """

    middle_m: Annotated[Any, _parse_point]
    _: KW_ONLY
    speed: Speed = "normal"

    def plan(self, context: ArmContext, start: Vector, grip: Grip | None = None) -> Planned:
        """Plan from the joints ``start`` (n,): move above, close again, down, open, up."""
        planner, T = _GraspPlanner(context, start, self.speed), context.planner.tip_pose(start)
        is_held = grip is not None and grip.is_held_at(context, start)
        known = grip.T_thing_tip if grip is not None and is_held else None
        R = (T if known is None else known)[:3, :3]
        roll_rad = planner.tool.roll_rad(R, math.atan2(T[1, 3], T[0, 3]))
        stance = ToolOrientation(planner.tool.pitch_rad(R), roll_rad, within_rad=_UPRIGHT_RAD)
        grip_m = (
            planner.jaws.at_width(_UNKNOWN_WIDTH_M)[1] if known is None else -R.T @ known[:3, 3]
        )
        kinds, held = ["to", "close", "down", "open", "away"], start[context.index.outside_chain()]
        middle_m = np.array(self.middle_m)
        if known is not None and grip is not None:
            bottom_m = middle_m[2] - grip.height_m / 2.0
            if bottom_m < (context.model.floor_m or 0.0) - _SUNK_M:
                raise RefusedError(
                    f"With its middle at {format_point(self.middle_m)}, the thing would be "
                    f"{-1000.0 * bottom_m:.0f} mm below the table.",
                    f"The thing is {1000.0 * grip.height_m:.0f} mm high; place it higher.",
                )
        return planner.plan(middle_m, _DROPS_M, [(stance, grip_m)], kinds, float(held[0]))

    def end(self, context: ArmContext, start: Vector) -> Vector:
        """Compute the joints (n,) after the motion from ``start`` (n,); nothing moves."""
        return self.plan(context, start)[1].goal

    def run(self, arm: ArmParts, on_progress: OnProgress | None, steps: Steps = ()) -> GraspResult:
        """Put down the thing, following a plan's ``steps``; raise if the gripper holds nothing."""
        grip, steps = _grip_of(arm), steps or _plan_now(self, arm)
        if not _run(arm, steps[:2], on_progress).grasped:
            grip.T_thing_tip = None
            raise RefusedError("The gripper holds nothing.", "Pick something up first.")
        report = _run(arm, steps[2:4], on_progress)
        grip.T_thing_tip = None
        _run(arm, steps[4:], on_progress)
        return report

    def __str__(self) -> str:
        return f"put down at {format_point(self.middle_m)}"


def pick(arm: OpenArm, thing: ArrayLike | KeepOutShape, **options: Any) -> GraspResult:  # noqa: ANN401
    """Pick up an upright box found by ``arm.camera``, or a thing at a point (3,); see ``Pick``.

    Raises:
        RefusedError: The thing is too wide or below the table, no grasp is possible, or the jaws
            gripped nothing.
        UnreachableError: The thing is out of reach; nothing moved.
    """
    kind = partial(pick_box, thing) if isinstance(thing, KeepOutShape) else partial(Pick, thing)
    return arm.execute(kind(**options))


def pick_box(box: KeepOutShape, **options: Any) -> Pick:  # noqa: ANN401
    """Return the motion that picks up an upright box; refuse things of other shapes."""
    if box.row[IS_CYLINDER] or box.row[ROUNDING] or box.row[8] < _UPRIGHT_COSINE:
        raise RefusedError(f"{box.name} is not an upright box.", "Give the point to grip instead.")
    yaw_rad = math.atan2(box.row[3], box.row[0])
    return Pick(box.row[9:12], size_m=2.0 * box.half_size_m, yaw_rad=yaw_rad, **options)


def place(arm: OpenArm, middle_m: ArrayLike, *, speed: str = "normal") -> GraspResult:
    """Put down the held thing with its middle at a point (3,) [m]; see ``Place``.

    Raises:
        RefusedError: The thing would be below the table, the path is blocked, or the gripper
            holds nothing.
        UnreachableError: The point is out of reach; nothing moved.
    """
    return arm.execute(Place(middle_m, speed=speed))


def _grip_of(arm: ArmParts) -> Grip:
    return cast("Any", arm).grip


def _plan_now(motion: Pick | Place, arm: ArmParts) -> Steps:
    """Plan all steps from the arm's present position; plan again if it sags before torque is on."""
    context, runner = arm.context, arm.runner
    slow_first = replace(motion, speed=runner.allowed_speed(motion.speed))
    steps, whole = slow_first.plan(context, runner.start_position(), _grip_of(arm))
    if not context.servos.torque.is_on:
        with runner.undisturbed():
            runner.enable()
        if has_moved(whole, runner.start_position(), context.planner.motion_limits("slow")):
            return _plan_now(motion, arm)
    return steps


def _run(arm: ArmParts, steps: Steps, on_progress: OnProgress | None) -> GraspResult:
    """Run steps, and return the result of the last jaw motion; imperfect settling is tolerated.

    While the arm moves, the jaws stay where they are; the plan only estimates their position.
    """
    found, outside = None, arm.context.index.outside_chain()
    for step in steps:
        if isinstance(step, MoveGripper):
            found = run_motion(arm, step, on_progress)
            continue
        jaws_at = arm.runner.start_position()[outside]
        start, goal = step.start.copy(), step.goal.copy()
        start[outside] = goal[outside] = jaws_at
        path = _JawsHold(step.trajectory, outside, jaws_at)
        with suppress(NotSettledError):
            execute(arm, replace(step, start=start, goal=goal, trajectory=path, limp_arm=None),
                    on_progress)  # fmt: skip
    return cast("GraspResult", found)


@dataclass(frozen=True, slots=True, eq=False)
class _JawsHold:
    """A trajectory in which the joints outside the chain (mask ``outside`` (n,)) stay at ``at``."""

    path: Trajectory
    outside: NDArray[np.bool_]
    at: Vector

    @property
    def duration_s(self) -> float:
        return self.path.duration_s

    def state(self, time_s: float) -> TrajectoryPoint:
        found = self.path.state(time_s)
        position = found.position.copy()
        position[self.outside] = self.at
        return replace(found, position=position)


class _GraspPlanner:
    """Planner of grasps from the positions (n,) of all joints; moves nothing and reads no servo."""

    def __init__(self, context: ArmContext, start: Vector, speed: str) -> None:
        context.require_zeros()
        self._context, self._start, self._speed = context, start, speed
        self.tool, self.jaws = tool_frame(context.model), find_jaws(context.model)

    def plan(
        self,
        middle_m: Vector,
        raises_m: Sequence[float],
        stances: Iterable[Stance],
        kinds: Sequence[str],
        held: float,
    ) -> Planned:
        """Try grasps, the best first; return the steps of the first possible grasp and their plan.

        ``kinds`` are the motions: "open" and "close" for the jaws, which close to ``held``;
        "to", "down" and "away" for the tip.
        """
        at, reason = format_point(middle_m.tolist()), "The gripper cannot be oriented for it."
        if middle_m[2] < (self._context.model.floor_m or 0.0):
            raise RefusedError(f"{at} is below the table.", "Nothing moved. Choose another point.")
        self._context.planner.reach(self._start, middle_m)
        until_s = perf_counter() + _SEARCH_S
        for stance, grip_m in stances:
            is_steep = stance.pitch_rad is not None and stance.pitch_rad < _FROM_ABOVE_RAD
            for is_up, length_m in product((True, False) if is_steep else (False,), _APPROACHES_M):
                # What touches at the end of one approach touches at that of all: first higher.
                for raise_m in raises_m:
                    self._context.servos.stop_request.check_request()
                    T = self.tip_at(middle_m + raise_m * _UP, stance, grip_m)
                    if T is None or perf_counter() > until_s:
                        break
                    way = _UP if is_up else -T[:3, :3] @ self.tool.approach_axis
                    poses = make_pose(-_LOWER_M * _UP, np.eye(3)) @ T, T
                    below, motions = (
                        self._motions(each, each[:3, 3] + length_m * way, stance, kinds)
                        for each in poses
                    )
                    try:
                        self._plan_all(below, held)
                        return self._plan_all(motions, held)
                    except (RefusedError, UnreachableError) as error:
                        reason = error.message
        raise RefusedError(
            f"{self._context.model.name} cannot grip or put down anything at {at}: {reason}",
            "Nothing moved. Choose another point, or move what is in the way.",
        )

    def tip_at(self, point_m: Vector, stance: ToolOrientation, grip_m: Vector) -> Matrix | None:
        """Return the tip pose (4, 4) that puts the tip's point ``grip_m`` at ``point_m``, or None.

        The orientation depends on the position of the tip, so the pose is solved iteratively.
        """
        chain, tip_m, R = self._context.chain, point_m, np.eye(3)
        q = self._context.index.chain_joints(self._start)
        for _ in range(3 if grip_m.any() else 1):
            try:
                found = solve_with_orientation(chain, self.tool, Target(tip_m), stance, q)
            except OrientationError:
                return None
            if not found.reached:
                return None
            q, R = found.q, chain.forward(found.q)[:3, :3]
            tip_m = point_m - R @ grip_m
        return make_pose(tip_m, R)

    def level_rolls(self, R: Matrix, pitch_rad: float, side_rad: float | None) -> list[float]:
        """Return the rolls at which a tool (3, 3) has level jaws that close along ``side_rad``."""
        heading_rad = self.tool.heading_rad(R) or 0.0
        turned = [self.tool.rotation(heading_rad, pitch_rad, roll) for roll in _ROLLS_RAD]
        x, y, z = (np.array(turned) @ self.jaws.axis).T
        aside = 0.0 if side_rad is None else np.abs(np.sin(np.arctan2(y, x) - side_rad))
        askew = np.maximum(np.abs(z), aside)
        best = int(np.argmin(askew))
        both = _ROLLS_RAD[[best, best - len(_ROLLS_RAD) // 2]].tolist()
        return sorted(both, key=abs) if askew[best] < _MAX_SKEW else []

    def _motions(
        self, T: Matrix, above_m: Vector, stance: ToolOrientation, kinds: Sequence[str]
    ) -> Motions:
        """Return the motions to a tip pose (4, 4) and back, both through a point (3,) above it."""
        loose, speed = replace(stance, within_rad=_LOOSE_RAD), self._speed
        parts: dict[str, MotionValue[Any]] = {
            "to": MoveTo(above_m, speed=speed, stance=loose, think_s=_THINK_S),
            "down": MoveLine(T[:3, 3], speed="slow", stance=stance),
            "away": MoveLine(above_m, speed=speed, stance=loose),
        }
        return [parts.get(kind) or MoveGripper(kind) for kind in kinds]

    def _plan_all(self, motions: Motions, held: float) -> Planned:
        """Plan motions in sequence; return them, and one plan of all; jaws close to ``held``."""
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
        path = reduce(ConcatenatedTrajectory, [each.trajectory for each in plans])
        path_m = sum(each.path_m for each in plans)
        pairs = zip(motions, plans, strict=True)
        steps = [motion if isinstance(motion, MoveGripper) else plan for motion, plan in pairs]
        return steps, replace(
            plans[-1], start=self._start, trajectory=path, path_m=path_m, duration_s=path.duration_s
        )

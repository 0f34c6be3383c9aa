"""Make plans and check them before they run: start position, limits and collisions."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import chain, islice, product
from math import radians
from time import perf_counter
from typing import Any, Protocol

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arguments import parse_all_positions
from ikservo.errors import (
    BadValueError,
    BlockedError,
    CollisionError,
    OrientationError,
    RefusedError,
    UnreachableError,
)
from ikservo.ik import in_millimetres
from ikservo.kinematics import finite_array, finite_vector
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.planning.calibrated_arm import MAX_UNCALIBRATED_STEP_RAD
from ikservo.planning.context import ArmContext
from ikservo.planning.motion_plan import MotionPlan
from ikservo.planning.motions import (
    THINK_S,
    Draw,
    LookAt,
    Lower,
    MotionValue,
    MoveJoints,
    MovePose,
    MoveThrough,
    MoveTo,
    MoveToRest,
    TipMotion,
)
from ikservo.planning.path_constraint import UNCONSTRAINED, PathConstraint
from ikservo.planning.planner import Planner, PointGoal
from ikservo.planning.poses import PoseLibrary, PoseWithinLimits, clamp_pose, clamp_positions
from ikservo.planning.tool_orientation import KEEP_BEST_EFFORT

# A gripper's goal leads it by more than this at the horn while it presses on something.
_PRESSING_LAG_RAD = 0.05
# If the whole path to the rest pose is not free, these fractions of it are tried.
_PATH_FRACTIONS = (0.8, 0.6, 0.4, 0.2)
_EXITS = 3  # most start postures for paths around obstacles
_NEARBY = 300  # most postures that are tried to find these
# These fractions of the line from the nearest point back to the tip are suggested.
_STEPS_BACK = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4)

# A point this far above a point at the table is tried instead, metres.
_STEPS_UP_M = (0.0, 0.03, 0.06, 0.1)


class MotionStart(Protocol):
    """The start and the allowed speed of a motion; ``MotionRunner`` provides those of the arm."""

    def start_position(self) -> Vector:
        """Return the start (n,), rad or m."""
        ...

    def allowed_speed(self, speed: str) -> str:
        """Return the speed class of the motion."""
        ...

    def enable(self) -> None:
        """Switch torque on, so that the arm holds its start."""
        ...


class PlannedStart:
    """The start of a motion that is only being planned.

    Args:
        joints: All joints (n,).
        allowed: The speed class in which the motion would run; if empty, the motion's speed class.
    """

    def __init__(self, joints: Vector, allowed: str = "") -> None:
        self.joints, self._allowed = joints, allowed

    def start_position(self) -> Vector:
        """Return the planned joints (n,)."""
        return self.joints

    def allowed_speed(self, speed: str) -> str:
        """Return the speed class of the motion."""
        return self._allowed or speed

    def enable(self) -> None:
        """Do nothing, because a plan moves nothing."""


@dataclass(frozen=True, slots=True, eq=False)
class _MotionRequest:
    """One motion to plan.

    Attributes:
        motion: The motion.
        start: The joints (n,) from which it starts, rad or m.
        allowed: The speed class in which the motion may run now.
        arm: The arm, with its surroundings at the time when the plan was requested.
    """

    motion: TipMotion | MoveJoints | LookAt
    start: Vector
    allowed: str
    arm: ArmContext

    @property
    def within(self) -> PathConstraint:
        """The constraint of the tool."""
        return UNCONSTRAINED if isinstance(self.motion, LookAt) else self.motion.within

    @property
    def think_s(self) -> float:
        """Time allowed for a search for a path around obstacles."""
        return self.motion.think_s if isinstance(self.motion, MoveTo | MoveJoints) else THINK_S


class PreflightPlanner:
    """Planner of an arm's motions that checks their paths without moving the arm."""

    def __init__(self, context: ArmContext, runner: MotionStart, poses: PoseLibrary) -> None:
        self._context, self._runner, self._poses = context, runner, poses
        self._model, self._planner, self._servos = context.model, context.planner, context.servos

    def plan(self, motion: MotionValue[Any]) -> MotionPlan:
        """Plan a motion of the tip or of joints from the start position and check its path.

        The plan uses the surroundings at the time of the call. A folded arm already touches
        itself; the plan first leaves that contact, unless the path starts at the current tip.

        Raises:
            UnreachableError: A point is out of reach; nothing has moved.
            RefusedError: The arm would touch itself, the table or a box, leave its limits, or
                violate a constraint.
            StoppedError: The arm was stopped meanwhile.
            CalibrationError: The arm is not calibrated.
            BadValueError: The motion has no plan, because it is not a tip motion or joint
                motion.
        """
        since_s = perf_counter()
        with self._servos.stop_request.requested():
            plan = self._plan_among(motion, self._context.at_present())
        plan = replace(plan, motion=motion, planning_s=perf_counter() - since_s)
        return plan if self._servos.torque.is_on else replace(plan, limp_arm=self._context)

    def _plan_among(self, motion: MotionValue[Any], arm: ArmContext) -> MotionPlan:
        match motion:
            case MoveTo():
                return self._plan_to_point(self._make_request(motion, arm), motion)
            case LookAt():
                plan = self._plan_tip(self._make_request(motion, arm))
                goals = self._context.index.by_name(plan.goal)
                return replace(plan, requested={n: goals[n] for n in self._context.chain.names})
            case _ if isinstance(motion, TipMotion):
                return self._plan_tip(self._make_request(motion, arm))
            case MoveJoints():
                return self._plan_joints(motion, arm)
            case MovePose():
                inside = self.pose_within_limits(motion.name)
                to_pose = MoveJoints(
                    inside.positions,
                    speed=motion.speed,
                    straight=motion.straight,
                    within=motion.within,
                    think_s=motion.think_s,
                )
                return replace(self._plan_joints(to_pose, arm), clamped=inside.changed)
            case MoveToRest():
                return self._plan_rest(arm)
            case Lower():
                return self._plan_lowering(arm)
            case _:
                expected = "a motion of the tip or of joints, such as MoveTo((0.25, 0.0, 0.15))"
                raise BadValueError("The motion to plan", str(motion), expected)

    def _make_request(
        self, motion: TipMotion | MoveJoints | LookAt, arm: ArmContext
    ) -> _MotionRequest:
        if not isinstance(motion, MoveJoints):
            arm.require_zeros()
        start = self._runner.start_position()
        return _MotionRequest(motion, start, self._runner.allowed_speed(motion.speed), arm)

    def _plan_directly(self, request: _MotionRequest) -> MotionPlan:
        return plan_motion(self._planner, request.motion, request.start, request.allowed)

    def _plan_tip(self, request: _MotionRequest) -> MotionPlan:
        if not request.motion.starts_at_tip:
            return self._plan_clear(request)
        plan = self._plan_directly(request)
        try:
            return self._check_clear(request, plan)
        except CollisionError as error:
            next(self._plans_around(request, plan.goal, error), None)  # adds a hint
            raise

    def _plan_to_point(self, request: _MotionRequest, motion: MoveTo) -> MotionPlan:
        """Plan a motion to a point; if none is possible, name a point that would be accepted."""
        try:
            return self._plan_tip(request)
        except OrientationError:
            raise
        except CollisionError as error:
            if error.pair[1] == "the table":
                self._describe_table(request, motion, error)
            raise
        except UnreachableError as error:
            instead_m = self._find_accepted_point(request, motion, np.array(error.nearest_m))
            better = UnreachableError(error.target_m, error.nearest_m, error.binding, instead_m)
        meant = in_millimetres(self._context.chain, better.target_m)
        if meant:
            better.command_hint = f"Did you mean millimetres? Try: ikservo move {meant}"
        raise better

    def _describe_table(
        self, request: _MotionRequest, motion: MoveTo, error: CollisionError
    ) -> None:
        """Add to an error that the point is below the table, and suggest a motion."""
        x, y, z = finite_vector(motion.position_m, 3, "The target").tolist()
        table_m = self._model.floor_m or 0.0
        if z < table_m:
            below = f"z = {z:.3f} m is below the table (z = {table_m:g} m)"
            error.command_message = f"{below}: {error.cause}."
        stances = [motion.stance]
        if motion.stance == KEEP_BEST_EFFORT:
            stances.append(replace(motion.stance, pitch_rad=-math.pi / 2))
        for up_m, stance in product(_STEPS_UP_M, stances):
            point_m = np.round([x, y, max(z, table_m) + up_m], 4)
            above = replace(motion, position_m=point_m, stance=stance, straight=True)
            with suppress(UnreachableError, RefusedError):
                self._plan_tip(replace(request, motion=above))
                x, y, z = point_m.tolist()
                down = "" if stance == motion.stance else " --pitch -90"
                error.command_hint = f"Try: ikservo move {x:.4f} {y:.4f} {z:.4f}{down}"
                return

    def _find_accepted_point(
        self, request: _MotionRequest, motion: MoveTo, nearest_m: Vector
    ) -> list[float] | None:
        """Return the first point (3,) [m] between ``nearest_m`` and the tip that can be planned.

        Points are rounded to whole millimetres; the result is None if all of them are refused.
        """
        tip_m = self._planner.tip(request.start)
        for fraction in _STEPS_BACK:
            point_m = np.round(nearest_m + fraction * (tip_m - nearest_m), 3)
            nearer = replace(motion, position_m=point_m, straight=True)
            with suppress(UnreachableError, RefusedError):
                self._plan_tip(replace(request, motion=nearer))
                return point_m.tolist()
        return None

    def _plan_joints(self, motion: MoveJoints, arm: ArmContext) -> MotionPlan:
        request, goals = self._make_request(motion, arm), motion.positions
        plan = self._plan_directly(request)
        joints = [self._model.joint(name) for name in self._servos.names]
        horn_turns = MAX_UNCALIBRATED_STEP_RAD / math.tau
        steps = {joint.name: horn_turns * joint.travel_per_turn for joint in joints}
        arm.zeros.check_small_steps(self._model.name, request.start, plan.goal, steps)
        try:
            self._servos.check_goal(plan.goal, request.start)
        except RefusedError as error:
            error.python_hint = self._ask_about_degrees(goals)
            raise
        if arm.zeros.are_known and set(arm.chain.names) <= set(goals):  # the whole arm
            plan = self._plan_clear(request, plan)
        else:
            plan = self._check_clear(request, plan)
        return replace(plan, requested=goals)

    def _ask_about_degrees(self, goals: Mapping[str, float]) -> str:
        """Return a hint if goals are outside the limits as radians but inside them as degrees."""
        driven_joints = {driven.joint: driven for driven in self._servos.driven_joints}
        for name, goal in goals.items():
            lower, upper = (
                driven_joints[name].limits.lower.value,
                driven_joints[name].limits.upper.value,
            )
            turned = driven_joints[name].limits.unit == "rad" and not lower <= goal <= upper
            was_typed = goal == round(goal, 3)  # 900° of a program file are 15.70796… rad
            if turned and was_typed and lower <= radians(goal) <= upper:
                meant = f"math.radians({goal:g}), which is {radians(goal):.4g}"
                return f"Positions are in radians. Did you mean {goal:g} degrees? Give {meant}."
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
        return clamp_pose(pose, positions, self._servos.driven_joints, start)

    def clearance_m(self, positions: Mapping[str, float] | ArrayLike) -> float:
        """Compute the clearance of the arm [m]; see ``Arm.clearance_m``."""
        names, index = self._servos.names, self._context.index
        by_name = parse_all_positions(positions, names)
        complete = len(by_name) == len(names)
        joints = np.zeros(len(names)) if complete else self._servos.measure_positions()
        for name, position in by_name.items():
            joints[index.column(name)] = position
        return self._context.clearance_m(finite_vector(joints, len(names), "The vector of joints"))

    def _plan_rest(self, arm: ArmContext) -> MotionPlan:
        """Plan the slow motion to the rest pose, through another pose if necessary."""
        rest = self.rest_pose()
        motion = MoveJoints(rest.positions, speed="slow", straight=True)
        try:
            plan = self._plan_joints(motion, arm)
        except RefusedError as error:
            request = self._make_request(motion, arm)
            tries = self._plans_via_pose(request)
            if isinstance(error, CollisionError):
                goal = self._plan_directly(request).goal
                around = replace(request, motion=replace(motion, straight=False))
                tries = chain(tries, self._plans_around(around, goal, error))
            found = next(tries, None)
            if found is None:
                raise
            plan = found
        return replace(plan, requested=rest.positions, clamped=rest.changed)

    def _plan_lowering(self, arm: ArmContext) -> MotionPlan:
        """Plan the slow motion to the rest pose, or the free part of it.

        Raises:
            CalibrationError: The arm is not calibrated.
            RefusedError: No part of the path is free.
            ServoAlarmError: A servo reports a state that would end the motion at once.
        """
        with self._servos.tolerate_heat():
            self._servos.check_health()
        try:
            return self._plan_rest(arm)
        except RefusedError:
            rest = self.rest_pose()
            start = self._context.index.by_name(self._runner.start_position())
            for fraction in _PATH_FRACTIONS:
                part = {
                    name: start[name] + fraction * (goal - start[name])
                    for name, goal in rest.positions.items()
                }
                with suppress(RefusedError):
                    plan = self._plan_joints(MoveJoints(part, speed="slow", straight=True), arm)
                    return replace(plan, requested=rest.positions, clamped=rest.changed)
            raise

    def rest_pose(self) -> PoseWithinLimits:
        """Return the rest pose within the limits; a gripper that presses keeps its position."""
        rest, gripper = dict(self._model.pose("rest")), self._model.gripper
        start = self._runner.start_position()
        if gripper is not None:
            column = self._context.index.column(gripper.joint)
            lag = abs(start[column] - self._servos.measure_positions()[column])
            joint_map = self._servos.driven_joints[column].joint_map
            if lag / joint_map.unit_per_horn_rad > _PRESSING_LAG_RAD:
                del rest[gripper.joint]
        return clamp_pose("rest", rest, self._servos.driven_joints, start)

    def plan_from_held(self, motion: MotionValue[Any]) -> MotionPlan:
        """Plan from the held position, because a limp arm may sink until torque is switched on."""
        plan = self.plan(motion)
        if self._servos.torque.is_on:
            return plan
        self._runner.enable()
        held = np.array_equal(plan.start, self._servos.reference())
        return plan if held else self.plan(motion)

    def _plan_clear(self, request: _MotionRequest, direct: MotionPlan | None = None) -> MotionPlan:
        """Make a plan whose path is free: the direct plan, or the first free alternative."""
        tool = self._planner.constrained_tool(request.within, request.start)
        if tool is not None:
            tool.check(self._context.index.chain_joints(request.start)[None])
        goal = request.start
        try:
            plan = direct or self._plan_directly(request)
            goal = plan.goal
            return self._check_clear(request, plan)
        except RefusedError as error:
            found = next(self._tries(request, goal, error), None)
            if found is None:
                raise
            return found

    def _tries(
        self, request: _MotionRequest, goal: Vector, error: RefusedError
    ) -> Iterator[MotionPlan]:
        """Yield collision-free plans that avoid obstacles, or that first leave a contact.

        An arm that touches something leaves the contact first. Other remedies are added to the hint
        of ``error``.
        """
        touches = request.arm.clearance_m(request.start) < 0.0
        blocked = error if isinstance(error, BlockedError) else None
        if blocked is not None and not touches:
            yield from self._plans_around(request, goal, blocked)
        if request.arm.is_in_contact(request.start):
            yield from self._plans_via_pose(request)
        if blocked is not None and touches:
            yield from self._plans_around(request, goal, blocked)
            blocked.command_hint += " Or first move the arm by hand until it is free."

    def _plans_via_pose(self, request: _MotionRequest) -> Iterator[MotionPlan]:
        """Yield collision-free plans that first leave a contact."""
        for pose, first in self._ways_out(request):
            with suppress(RefusedError):
                then = self._plan_directly(replace(request, start=first.goal))
                yield self._check_clear(request, self._join(first, then, pose))

    def _plans_around(
        self, request: _MotionRequest, goal: Vector, blocked: BlockedError
    ) -> Iterator[MotionPlan]:
        """Yield collision-free joint plans around the obstacle on the straight path.

        For a line, the error says whether the joints can move around the obstacle.
        """
        motion, start, think_s = request.motion, request.start, request.think_s
        if isinstance(motion, MoveTo | MoveJoints):
            if motion.straight:
                return
        elif isinstance(motion, Draw | LookAt) or (
            isinstance(motion, MoveThrough) and not motion.line
        ):
            return
        goals, points = [goal], list[PointGoal]()
        if isinstance(motion, MoveTo):
            tool = self._planner.constrained_tool(request.within, start)
            points = self._planner.goals_at(start, motion.position_m, motion.stance, tool)
            goals = [point.joints for point in points]
        if not goals:
            return
        since_s = perf_counter()
        ways = self._ways_around(
            request, np.array(goals), lambda: perf_counter() - since_s > think_s
        )
        for tried in ways:
            with suppress(RefusedError):
                plan = self._check_clear(request, tried)
                if not isinstance(motion, MoveTo | MoveJoints):
                    to = " ".join(f"{x:.3f}" for x in plan.tip_m.tolist())
                    blocked.command_hint += f" A joint motion can go around it: ikservo move {to}."
                    return
                for point in points:
                    if np.allclose(point.joints, plan.goal):
                        plan = point.reached_by(plan)
                yield replace(plan, around=blocked.cause)
        spent_s = perf_counter() - since_s
        if spent_s > think_s:
            longer = f"--think {3.0 * think_s:g}s searches longer."
            blocked.command_hint += f" No path around it was found in {think_s:g} s; {longer}"
            return
        load_factor = self._planner.dynamic_load_factor(request.allowed)
        if all(request.arm.is_in_contact(goal, load_factor, 0.0) for goal in goals):
            blocked.command_hint += " The arm would touch something in every posture at the target."
        else:
            blocked.command_hint += f" A search of {spent_s:.1g} s found no path around it."

    def _ways_around(
        self, request: _MotionRequest, goals: Matrix, is_over: Callable[[], bool]
    ) -> Iterator[MotionPlan]:
        """Yield plans around obstacles to one of the goals (m, n), best first, until time is up.

        An arm that touches something leaves that contact first.
        """
        from ikservo.planning.ways_around import BLENDS_RAD, ways_around  # noqa: PLC0415

        start, allowed = request.start, request.allowed
        load_factor = self._planner.dynamic_load_factor(allowed)
        for first in chain([None], islice(self._exits(request, load_factor), _EXITS)):
            begin = start if first is None else first.goal
            tool = self._planner.constrained_tool(request.within, start)
            if tool is not None:
                tool.admit(self._context.index.chain_joints(goals))
            takes_time = request.think_s > THINK_S
            ways = ways_around(
                request.arm, begin, goals, load_factor, tool, is_over, takes_time=takes_time
            )
            for way in ways:
                for blend in BLENDS_RAD if len(way) > 2 else BLENDS_RAD[:1]:
                    plan = self._planner.plan_along(begin, list(way[1:]), allowed, blend)
                    yield plan if first is None else self._join(first, plan, "")

    def _exits(self, request: _MotionRequest, load_factor: float) -> Iterator[MotionPlan]:
        """Yield short collision-free motions from a contact to postures without contact."""
        arm, start, allowed = request.arm, request.start, request.allowed
        if not arm.is_in_contact(start, load_factor, 0.0):
            return
        from ikservo.planning.ways_around import postures_nearby  # noqa: PLC0415

        nearest = arm.nearest_free_joints(start)
        nearby = postures_nearby(arm, start, load_factor)
        for free in chain([] if nearest is None else [nearest], islice(nearby, _NEARBY)):
            goals = MoveJoints(arm.index.by_name(free), speed=allowed)  # without a tool constraint
            leaving = replace(request, motion=goals)
            with suppress(RefusedError):
                yield self._check_clear(leaving, self._plan_directly(leaving))

    def _ways_out(self, request: _MotionRequest) -> Iterator[tuple[str, MotionPlan]]:
        """Yield motions out of a contact, each with the retract pose where it ends; "" if none.

        The first motion goes only as far as needed to touch nothing; it has no retract pose.
        """
        from ikservo.planning.ways_around import RETRACT_POSES  # noqa: PLC0415

        start, allowed = request.start, request.allowed
        free = request.arm.nearest_free_joints(start)
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
        inside = clamp_positions(named, self._servos.driven_joints, start, max_rad=math.inf)
        return self._planner.plan_to_joints(start, inside.positions, allowed)

    def _join(self, first: MotionPlan, then: MotionPlan, pose: str) -> MotionPlan:
        from ikservo.planning.ways_around import via_pose_plan  # noqa: PLC0415

        change_rad = self._planner.rotation_between(first.start, then.goal)
        return via_pose_plan(first, then, pose, change_rad)

    def _check_clear(self, request: _MotionRequest, plan: MotionPlan) -> MotionPlan:
        """Check that the path of a plan is free, and return the plan with the results of the check.

        Raises:
            RefusedError: The arm would touch something, or violate a constraint.
            StoppedError: The arm was stopped meanwhile.
        """
        self._servos.stop_request.check_request()
        kept = self._planner.check_constraint(request.within, plan.trajectory, plan.speed)
        clearance_m = request.arm.check_streamed_path(plan.trajectory, plan.speed)
        reduced = plan.speed != request.motion.speed
        return replace(plan, kept=kept, clearance_m=clearance_m, speed_reduced=reduced)


def plan_motion(
    planner: Planner, motion: TipMotion | MoveJoints | LookAt, start: Vector, speed: str
) -> MotionPlan:
    """Plan a motion from the joints ``start`` (n,) [rad or m]; collisions are not checked.

    The speed class may be slower than the motion's own.

    Raises:
        UnreachableError: A point is out of reach.
        OrientationError: The tool cannot have the requested orientation there.
        AimError: The tool cannot point at the point.
        BadValueError: The path of the motion cannot be computed from this start.
    """
    match motion:
        case MoveTo():
            return planner.plan_to_point(start, motion.position_m, speed, motion.stance)
        case MoveThrough(line=False):
            points_m, blend_m = list(motion.points_m), motion.blend_m
            return planner.plan_waypoints(start, points_m, speed, blend_m, motion.stance)
        case Draw():
            from ikservo.planning.strokes import plan_drawing  # noqa: PLC0415  # few programs draw

            return plan_drawing(planner, motion, start, speed)
        case LookAt():
            return planner.plan_to_look(start, motion.point_m, speed)
        case MoveJoints():
            return planner.plan_to_joints(start, motion.positions, speed)
        case _:
            path = motion.path_from(planner.path_start(start))
            return planner.plan_path(start, path, speed, motion.stance, motion.tool_speed_m_s)

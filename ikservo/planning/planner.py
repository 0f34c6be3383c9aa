"""Plan motions of one arm: to a point, along a line, through points, or of single joints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import (
    AimError,
    BadValueError,
    CartesianPathError,
    InputError,
    OrientationError,
    UnreachableError,
)
from ikservo.guard import MAX_TRAVEL_RAD, sample_path
from ikservo.ik import Result, Target
from ikservo.kinematics import Chain, JointIndex
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.inertia import GRAVITY_M_S2
from ikservo.kinematics.se3 import log_so3
from ikservo.model import Model
from ikservo.model.joint_drive import nominal_parameters
from ikservo.model.tool import tool_frame
from ikservo.model.travel_after_kill import stopping_times_s
from ikservo.motion import (
    CartesianTrajectory,
    JointMove,
    JointWaypointTrajectory,
    KinematicLimits,
    SubsetTrajectory,
    ToolPath,
    Trajectory,
    straight_lines,
)
from ikservo.planning.loaded_limits import limits_under_load
from ikservo.planning.motion_plan import (
    MotionPlan,
    near_limits,
    path_length_m,
    sample_states,
    time_limiting_joints,
)
from ikservo.planning.path_constraint import ConstrainedTool, PathConstraint
from ikservo.planning.tool_orientation import (
    KEEP_BEST_EFFORT,
    ToolOrientation,
    check_orientation_error,
    solve_with_orientation,
)
from ikservo.planning.tool_speed import ToolSpeed, sample_times_s, tool_speed_between


def unreachable_error(target: Target, solution: Result) -> UnreachableError:
    """Return an UnreachableError that contains the reachable point nearest to a target."""
    return UnreachableError(
        target.position.tolist(),
        solution.nearest_m.tolist(),
        [str(limit) for limit in solution.binding],
    )


# Longest motion of a joint, even over many revolutions.
_MAX_JOINT_STEP_RAD = 1000.0
# Checks sample a motion at equal intervals: a longer motion would take minutes and all memory.
_LONGEST_S = 3600.0
# Top speed of the tip on a line; safety standards call 0.25 m/s reduced speed.
_TIP_M_S = {"slow": 0.1, "normal": 0.25, "fast": 0.5}
_STARTS = 24  # number of random starts to solve for a point
_MISSES = 4  # after this many failures without a success, the remaining starts are left out
_SAME_GOAL = 0.05  # solutions that differ by less are the same, rad or m
# Fraction of a blend at which a waypoint is passed; see ``BlendedPath``.
_PASSED = 0.375


@dataclass(frozen=True, slots=True, eq=False)
class PointGoal:
    """Joints that place the tip at a point.

    Attributes:
        joints: All joints (n,), rad or m.
        target: The point.
        solved: The solution for the point and the orientation of the tool.
        stance: The requested stance.
    """

    joints: Vector
    target: Target
    solved: Result
    stance: ToolOrientation

    def reached_by(self, plan: MotionPlan) -> MotionPlan:
        """Return a plan that reaches this goal, with the goal's target and tool orientation."""
        return _with_target(plan, self.target, self.solved, self.stance)


class Planner:
    """Planner of one arm's motions without side effects; reads no servo.

    Args:
        model: The arm's model.
        chain: The joints from base to tool, with this arm's limits.
        index: The columns of the joints in the vectors (n,) of plans.
    """

    def __init__(self, model: Model, chain: Chain, index: JointIndex) -> None:
        self._model, self._chain, self._index = model, chain, index
        self._tool = tool_frame(model)
        self._joints = [model.joint(name) for name in index.names]
        self._units = tuple(joint.joint_map.unit for joint in self._joints)
        self._parameters = nominal_parameters(model, chain)
        times_s = stopping_times_s(model, chain)
        self._top_speeds_rad_s = [
            MAX_TRAVEL_RAD / times_s[name] if name in times_s else math.inf for name in index.names
        ]

    def plan_to_point(
        self,
        start: Vector,
        position_m: ArrayLike,
        speed: str,
        stance: ToolOrientation = KEEP_BEST_EFFORT,
    ) -> MotionPlan:
        """Plan a motion of the tip from the joints ``start`` (n,) to a point (3,) [m].

        Raises:
            UnreachableError: No joint positions inside the limits reach the point; the error has
                the nearest point in reach.
            OrientationError: The tool cannot have the requested orientation there.
            BadValueError: The point is not three finite numbers.
            UnknownNameError: There is no such speed.
        """
        limits, target = self.motion_limits(speed), Target(position_m)
        solved = self._solve_orientation(start, target, stance)
        goal = self._index.with_chain(start, solved.q)
        plan = self._make_plan(start, JointMove(start, goal, limits), speed)
        return _with_target(plan, target, solved, stance)

    def plan_linear(
        self,
        start: Vector,
        points_m: Sequence[ArrayLike],
        speed: str,
        blend_m: float = 0.02,
        stance: ToolOrientation = KEEP_BEST_EFFORT,
        tool_speed_m_s: float | None = None,
    ) -> MotionPlan:
        """Plan straight lines of the tip through points (k, 3) [m], with rounded corners.

        See ``plan_path``.

        Raises:
            InputError: The errors of ``plan_path``.
        """
        path = straight_lines(self.path_start(start), points_m, blend_m)
        return self.plan_path(start, path, speed, stance, tool_speed_m_s)

    def plan_path(
        self,
        start: Vector,
        path: ToolPath,
        speed: str,
        stance: ToolOrientation = KEEP_BEST_EFFORT,
        tool_speed_m_s: float | None = None,
    ) -> MotionPlan:
        """Plan a motion of the tip from the joints ``start`` (n,) along a path.

        The path begins at ``path_start``. Without a constant ``tool_speed_m_s``, the tip is as fast
        as the speed class allows.

        Raises:
            UnreachableError: The end, or another point of the path, is out of reach, and named.
            OrientationError: The tool cannot have the requested orientation.
            InputError: The path is impossible, a preferred posture was requested, or the motion
                would take more than an hour at this speed of the tool.
            UnknownNameError: There is no such speed.
        """
        if stance.posture is not None:
            raise InputError(
                "A straight line cannot keep a preferred posture.",
                "Give a tool orientation, or nothing.",
            )
        start = self._clip_to_limits(start)
        q = self._index.chain_joints(start)
        target = Target(path.at(path.length)[0])
        solved = self._solve_orientation(start, target, replace(stance, keep=False))
        end = solved.q if stance.constrains_more_than_keep else None
        line = self._follow_under_load(q, path, speed, tool_speed_m_s, end, strict=stance.keep)
        solved = replace(
            solved,
            q=line.goal,
            nearest_m=self._chain.forward(line.goal)[:3, 3],
            orientation_error_rad=float(line.orientation_error_rad.max()),
        )
        if stance.constrains_more_than_keep:
            solved = check_orientation_error(self._chain, self._tool, target, stance, solved)
        trajectory = SubsetTrajectory(line, list(self._index.chain), start)
        plan = replace(
            self._make_plan(start, trajectory, speed),
            is_cartesian=True,
            cartesian_s=trajectory.duration_s,
        )
        if tool_speed_m_s is not None:
            if plan.duration_s > _LONGEST_S:
                raise BadValueError(
                    "The speed of the tool",
                    f"{tool_speed_m_s:g} m/s",
                    "a speed at which the motion takes at most an hour",
                )
            plan = replace(plan, tool_speed=self._tool_speed(plan, tool_speed_m_s))
        return _with_target(plan, target, solved, stance)

    def plan_waypoints(
        self,
        start: Vector,
        points_m: Sequence[ArrayLike],
        speed: str,
        blend_m: float,
        stance: ToolOrientation = KEEP_BEST_EFFORT,
    ) -> MotionPlan:
        """Plan a joint motion that passes points (k, 3) [m] without stopping.

        Raises:
            UnreachableError: A point is out of reach.
            OrientationError: The tool cannot have the requested orientation at the last point.
            UnknownNameError: There is no such speed.
        """
        limits, target = self.motion_limits(speed), Target(points_m[-1])
        start = self._clip_to_limits(start)
        goals, blends, at = list[Vector](), list[float](), start
        for point_m in points_m[:-1]:
            solved = self._solve_orientation(at, Target(point_m), KEEP_BEST_EFFORT)
            at = self._index.with_chain(start, solved.q)
            goals.append(at)
            J = self._chain.jacobian(solved.q)[:3]
            # With this blend of the joints the tip passes the point within ``blend_m``.
            blends.append(blend_m / (_PASSED * float(np.linalg.norm(J, axis=0).sum())))
        solved = self._solve_orientation(at, target, stance)
        goals.append(self._index.with_chain(start, solved.q))
        plan = self._make_plan(start, JointWaypointTrajectory(start, goals, limits, blends), speed)
        return _with_target(plan, target, solved, stance)

    def plan_along(
        self, start: Vector, points: Sequence[Vector], speed: str, blend: float
    ) -> MotionPlan:
        """Plan a joint motion through points (n,), with rounded corners and rest at the end.

        ``blend`` is the distance before a point at which the straight path is left, rad or m.
        """
        trajectory = JointWaypointTrajectory(start, points, self.motion_limits(speed), blend)
        return self._make_plan(start, trajectory, speed)

    def constrained_tool(self, within: PathConstraint, start: Vector) -> ConstrainedTool | None:
        """Return the tool with the constraint that joints (n,) define; None if there is none."""
        if not within.constrains:
            return None
        q = self._index.chain_joints(start)
        return ConstrainedTool(within, self._chain, self._tool.approach_axis, q)

    def check_constraint(
        self, within: PathConstraint, trajectory: Trajectory, speed: str
    ) -> tuple[str, ...]:
        """Check the tool's constraint along a trajectory; return how much of it is used.

        Raises:
            ConstraintError: The constraint is violated; the message says by how much and where.
        """
        tool = self.constrained_tool(within, trajectory.state(0.0).position)
        if tool is None:
            return ()
        return tool.check(self._index.chain_joints(self.sample_trajectory(trajectory, speed)))

    def goals_at(
        self,
        start: Vector,
        position_m: ArrayLike,
        stance: ToolOrientation,
        tool: ConstrainedTool | None = None,
    ) -> list[PointGoal]:
        """Find all joints (n,) with the tip at a point (3,) [m], by solving from many starts.

        If ``tool`` is constrained, the solutions are inside its limits.

        Returns:
            Distinct solutions: first the solution found from ``start`` (n,), then the others,
            nearest first; empty if there is no solution.
        """
        target, q0 = Target(position_m), self._index.chain_joints(start)
        if stance.keep:
            stance = ToolOrientation(orientation=self.tip_pose(start)[:3, :3])
        lower = np.maximum(self._chain.lower_rad, -math.pi)
        upper = np.minimum(self._chain.upper_rad, math.pi)
        random = np.random.default_rng(len(q0))
        tried = random.uniform(lower, upper, (_STARTS, len(q0)))
        found, misses = list[PointGoal](), 0
        for q in (q0, *sorted(tried, key=lambda each: float(np.linalg.norm(each - q0)))):
            if misses == _MISSES and not found:
                break  # each solve already searches from many starts
            wanted = stance.varied(random) if found else stance
            solved = self._solve_variation(target, wanted, stance, q)
            if solved is None:
                misses += 1
                continue
            if tool is not None and not tool.keeps(solved.q[None])[0]:
                inside = tool.project(solved.q, target.position)
                if inside is None or stance.is_constrained:
                    continue
                solved = replace(solved, q=inside)
            joints = self._index.with_chain(start, solved.q)
            apart = [float(np.abs(joints - each.joints).max()) for each in found]
            if min(apart, default=1.0) > _SAME_GOAL:
                found.append(PointGoal(joints, target, solved, stance))
        return found[:1] + sorted(
            found[1:], key=lambda each: float(np.linalg.norm(each.joints - start))
        )

    def plan_to_joints(
        self, start: Vector, positions: Mapping[str, float], speed: str
    ) -> MotionPlan:
        """Plan a motion of some joints to positions in rad (m for a prismatic joint).

        Raises:
            BadValueError: No joint is named, or a position is not finite.
            UnknownNameError: There is no such joint or speed.
        """
        if not positions:
            raise BadValueError("The list of joints", "empty", "at least one joint")
        goal = start.copy()
        for name, position in positions.items():
            if not abs(position) <= _MAX_JOINT_STEP_RAD:
                raise BadValueError(f"The goal of {name}", position, "a number within ±1000")
            goal[self._index.column(name)] = position
        return self._make_plan(start, JointMove(start, goal, self.motion_limits(speed)), speed)

    def plan_to_look(self, start: Vector, point_m: ArrayLike, speed: str) -> MotionPlan:
        """Plan a motion after which the tool axis points at a point (3,) [m].

        Raises:
            AimError: No joint positions inside the limits were found that aim the axis there.
        """
        from ikservo.ik.sight import solve_sight  # noqa: PLC0415  # few motions aim

        now = self._index.chain_joints(start)
        sight = solve_sight(self._chain, point_m, now, self._tool.approach_axis)
        if not sight.reached:
            point = np.asarray(point_m, dtype=float).tolist()
            raise AimError(point, sight.error_rad, [str(limit) for limit in sight.binding])
        goals = dict(zip(self._chain.names, sight.q.tolist(), strict=True))
        return self.plan_to_joints(start, goals, speed)

    def sample_trajectory(
        self, trajectory: Trajectory, speed: str, from_s: float = 0.0, until_s: float = math.inf
    ) -> Matrix:
        """Sample all joints (k, n) along a trajectory, close enough for collision checks."""
        fastest = max(limits.speed_rad_s for limits in self.motion_limits(speed))
        piece_s = max(min(until_s, trajectory.duration_s) - from_s, 0.0)
        return sample_path(
            lambda time_s: trajectory.state(from_s + time_s).position, piece_s, fastest
        )

    def dynamic_load_factor(self, speed: str) -> float:
        """Compute the load on a braking arm at a speed class, as a multiple of the arm's weight."""
        reach_m = max(
            float(np.linalg.norm(self._chain.forward(self._model.chain_pose(pose))[:2, 3]))
            for pose in self._model.poses
        )
        return 1.0 + self._model.speed(speed).rad_s2 * reach_m / GRAVITY_M_S2

    def reach(self, start: Vector, point_m: ArrayLike) -> Vector:
        """Return all joints (n,) with the tip at a point (3,) [m], near the joints ``start`` (n,).

        Raises:
            UnreachableError: No joint positions inside the limits reach the point; the error has
                the nearest point in reach.
        """
        solved = self._solve_orientation(start, Target(point_m), KEEP_BEST_EFFORT)
        return self._index.with_chain(start, solved.q)

    def path_start(self, start: Vector) -> Vector:
        """Compute the tip (3,) [m] at which a path from the joints ``start`` (n,) begins.

        Joints of the chain that are outside their limits start at the limit.
        """
        return self.tip(self._clip_to_limits(start))

    def tip(self, joints: Vector) -> Vector:
        """Return the tip (3,) [m] for the joints (n,)."""
        return self.tip_pose(joints)[:3, 3]

    def tips(self, joints: Matrix) -> Matrix:
        """Return the tips (k, 3) [m] for joints (k, n)."""
        return self._chain.forward(self._index.chain_joints(joints))[:, :3, 3]

    def tip_pose(self, joints: Vector) -> Matrix:
        """Return T_base_tip (4, 4) for the joints (n,)."""
        return self._chain.forward(self._index.chain_joints(joints))

    def rotation_between(self, a: Vector, b: Vector) -> float:
        """Compute the angle between the tool's orientations at joints ``a`` and ``b`` (n,), rad."""
        R_a, R_b = (self.tip_pose(joints)[:3, :3] for joints in (a, b))
        return float(np.linalg.norm(log_so3(R_b @ R_a.T)))

    def motion_limits(self, speed: str) -> list[KinematicLimits]:
        """Return the kinematic limits of each joint; a prismatic joint has those of its horn, in m.

        In every speed class, the speed of a joint is limited so that it travels at most
        ``guard.MAX_TRAVEL_RAD`` after the last goal.

        Raises:
            UnknownNameError: There is no such speed.
        """
        horn = self._model.speed(speed)
        return [
            KinematicLimits(min(horn.rad_s, top_rad_s), horn.rad_s2, horn.rad_s3).scale_units(
                joint.travel_per_turn / math.tau
            )
            for joint, top_rad_s in zip(self._joints, self._top_speeds_rad_s, strict=True)
        ]

    def _solve_orientation(self, start: Vector, target: Target, stance: ToolOrientation) -> Result:
        q = self._index.chain_joints(start)
        solved = solve_with_orientation(self._chain, self._tool, target, stance, q)
        if not solved.reached:
            raise unreachable_error(target, solved)
        return solved

    def _solve_variation(
        self, target: Target, wanted: ToolOrientation, stance: ToolOrientation, q: Vector
    ) -> Result | None:
        """Solve for ``wanted``, an orientation that ``stance`` allows; None if this fails."""
        try:
            solved = solve_with_orientation(self._chain, self._tool, target, wanted, q)
            if wanted is not stance:
                solved = check_orientation_error(self._chain, self._tool, target, stance, solved)
        except OrientationError:
            return None
        return solved if solved.reached else None

    def _clip_to_limits(self, joints: Vector) -> Vector:
        """Return all joints (n,), with the chain's joints clipped to its limits."""
        return self._index.with_chain(joints, self._chain.clip(self._index.chain_joints(joints)))

    def _follow_under_load(
        self,
        q: Vector,
        path: ToolPath,
        speed: str,
        tool_speed_m_s: float | None,
        end: Vector | None,
        *,
        strict: bool,
    ) -> CartesianTrajectory:
        """Follow a path inside limits that are reduced by the lead of goals under load.

        See ``CartesianTrajectory`` for ``q``, ``path``, ``tool_speed_m_s``, ``end``, ``strict``.
        """
        limits = self.motion_limits(speed)

        def follow(chain: Chain) -> CartesianTrajectory:
            return CartesianTrajectory(
                chain,
                q,
                path,
                [limits[column] for column in self._index.chain],
                speed_m_s=_TIP_M_S[speed],
                tool_speed_m_s=tool_speed_m_s,
                end=end,
                strict=strict,
            )

        line = follow(self._chain)
        if self._parameters is None:
            return line
        joints = sample_states(line)[0]
        for friction in (True, False):  # a path is not refused because of friction alone
            loaded = limits_under_load(self._chain, self._parameters, joints, friction=friction)
            if loaded is None:
                return line
            try:
                return follow(loaded)
            except CartesianPathError as found:
                error = found
        cause = "a joint that holds the arm's weight cannot go right up to its limit"
        binding = [*error.binding, cause]
        raise CartesianPathError(
            error.along_m, error.target_m, error.nearest_m, binding, error.shape
        ) from error

    def _tool_speed(self, plan: MotionPlan, requested_m_s: float) -> ToolSpeed:
        times_s = sample_times_s(plan.trajectory)
        joints = np.array([plan.trajectory.state(at_s).position for at_s in times_s])
        found = tool_speed_between(self.tips(joints), times_s[1], requested_m_s)
        return found.with_reasons(plan.time_limiting_joints, plan.speed, _TIP_M_S[plan.speed])

    def _make_plan(self, start: Vector, trajectory: Trajectory, speed: str) -> MotionPlan:
        position, velocity, acceleration = sample_states(trajectory)
        goal, chain, names = position[-1], self._chain, self._index.names
        q = self._index.chain_joints(position)
        return MotionPlan(
            start=start,
            goal=goal,
            trajectory=trajectory,
            tip_m=self.tip(goal),
            path_m=path_length_m(chain, q),
            duration_s=trajectory.duration_s,
            speed=speed,
            time_limiting_joints=tuple(
                time_limiting_joints(velocity, acceleration, self.motion_limits(speed), names)
            ),
            near_limits=near_limits(
                q,
                chain.lower_rad,
                chain.upper_rad,
                chain.names,
                [self._units[column] for column in self._index.chain],
            ),
            orientation_change_rad=self.rotation_between(start, goal),
            names=names,
            units=self._units,
        )


def _with_target(
    plan: MotionPlan, target: Target, solved: Result, stance: ToolOrientation
) -> MotionPlan:
    """Return the plan with its target and the tool's orientation at the target."""
    return replace(
        plan,
        target_m=target.position,
        solution=solved,
        orientation_error_rad=solved.orientation_error_rad,
        orientation_requested=stance.is_constrained,
    )

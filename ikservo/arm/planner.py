"""Plans motions of one arm: to a point, along a line, through points, of single joints."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arm.orientation_solver import (
    OrientationSolution,
    check_orientation_error,
    solve_with_orientation,
)
from ikservo.arm.plan import (
    MotionPlan,
    near_limits,
    path_length_m,
    sample_states,
    time_limiting_joints,
)
from ikservo.arm.tool_orientation import KEEP_BEST_EFFORT, ToolOrientation
from ikservo.errors import BadValueError, RefusedError, UnreachableError
from ikservo.guard import sample_path
from ikservo.ik import Result, Target, in_millimetres
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.chain import GRAVITY_M_S2
from ikservo.kinematics.se3 import log_so3
from ikservo.model import Model
from ikservo.model.tool import tool_frame
from ikservo.motion import (
    CartesianTrajectory,
    JointMove,
    JointWaypointTrajectory,
    KinematicLimits,
    SubsetTrajectory,
    Trajectory,
)

__all__ = ["Planner", "unreachable_error", "with_suggested_point"]


_STEPS_BACK = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.4)


def unreachable_error(target: Target, solution: Result) -> UnreachableError:
    """Return the error that says how near the arm comes to a target."""
    return UnreachableError(
        target.position.tolist(),
        solution.nearest_m.tolist(),
        [str(limit) for limit in solution.binding],
    )


def with_suggested_point(
    error: UnreachableError, chain: Chain, tip_m: Vector, plan: Callable[[Vector], object]
) -> UnreachableError:
    """Return the error with a point in whole millimetres whose motion is accepted, if one is found.

    Args:
        error: What was said of the point.
        chain: The arm.
        tip_m: Where the tip is now (3,).
        plan: Plans the motion to a point (3,) as it was asked for, with all checks.
    """
    instead_m = next(_accepted_points(np.array(error.nearest_m), tip_m, plan), None)
    better = UnreachableError(error.target_m, error.nearest_m, error.binding, instead_m)
    meant = in_millimetres(chain, error.target_m)
    if meant:
        better.command_hint = f"Did you mean millimetres? Try: ikservo move {meant}"
    return better


def _accepted_points(
    nearest_m: Vector, tip_m: Vector, plan: Callable[[Vector], object]
) -> Iterator[list[float]]:
    """Yield round points that are accepted, from the edge of the reach towards the tip."""
    for share in _STEPS_BACK:
        point_m = np.round(nearest_m + share * (tip_m - nearest_m), 3)
        try:
            plan(point_m)
        except (UnreachableError, RefusedError):
            continue
        yield [float(x) for x in point_m]


# No servo's joint goes further, many turns included.
_MAX_JOINT_STEP_RAD = 1000.0
# How fast the tip goes on a line at most; 0.25 m/s is what safety standards call reduced speed.
_TIP_M_S = {"slow": 0.1, "normal": 0.25, "fast": 0.5}
# The share of a blend by which a way-point is passed; see ``BlendedPath``.
_PASSED = 0.375


class Planner:
    """Plans motions of one arm; pure, it knows no servo.

    Args:
        model: What the arm is.
        chain: Base to tool inside this arm's limits.
        names: The joints in the order of the vectors (n,) that plans are made of.
    """

    def __init__(self, model: Model, chain: Chain, names: Sequence[str]) -> None:
        self._model, self._chain, self._names = model, chain, list(names)
        self._columns = [self._names.index(name) for name in chain.names]
        self._tool = tool_frame(model)
        self._units = tuple(model.joint(name).joint_map.unit for name in names)

    def plan_to_point(
        self,
        here: Vector,
        position_m: ArrayLike,
        speed: str,
        stance: ToolOrientation = KEEP_BEST_EFFORT,
    ) -> MotionPlan:
        """Plan a motion of the tip from the joints ``here`` (n,) to a point (3,) [m].

        Raises:
            UnreachableError: No joints inside the limits reach it; carries the nearest point.
            OrientationError: The tool cannot stand there as asked.
            BadValueError: No three finite numbers.
            UnknownNameError: No such speed.
        """
        paces, target = self.motion_limits(speed), Target(position_m)
        standing = self._solve_orientation(here, target, stance)
        goal = self._with_chain_joints(here, standing.solution.q)
        plan = self._make_plan(here, JointMove(here, goal, paces), speed)
        return _with_target(plan, target, standing, stance)

    def plan_linear(
        self,
        here: Vector,
        points_m: Sequence[ArrayLike],
        speed: str,
        blend_m: float,
        stance: ToolOrientation = KEEP_BEST_EFFORT,
    ) -> MotionPlan:
        """Plan straight lines of the tip through points (k, 3) [m], their corners rounded.

        Raises:
            UnreachableError: The last point is out of reach, or a way to it; says where.
            OrientationError: The tool cannot stand there as asked.
            BadValueError: No point, no finite numbers, no positive blend, or a preferred posture.
            UnknownNameError: No such speed.
        """
        if stance.posture is not None:
            raise BadValueError("The stance on a line", "a posture", "how the tool stands, or none")
        paces, target = self.motion_limits(speed), _last_target(points_m)
        here = self._with_chain_joints(here, self._chain.clip(here[self._columns]))
        standing = self._solve_orientation(here, target, replace(stance, keep=False))
        route = CartesianTrajectory(
            self._chain,
            here[self._columns],
            points_m,
            [paces[i] for i in self._columns],
            speed_m_s=_TIP_M_S[speed],
            blend_m=blend_m,
            end=standing.solution.q if stance.constrains_more_than_keep else None,
            strict=stance.keep,
        )
        solution = replace(
            standing.solution, q=route.goal, nearest_m=self._chain.forward(route.goal)[:3, 3]
        )
        left_rad = float(route.orientation_error_rad.max())
        if stance.constrains_more_than_keep:
            left_rad = check_orientation_error(self._chain, self._tool, target, stance, solution)
        plan = self._make_plan(here, SubsetTrajectory(route, self._columns, here), speed)
        return _with_target(
            replace(plan, is_cartesian=True),
            target,
            OrientationSolution(solution, left_rad),
            stance,
        )

    def plan_waypoints(
        self,
        here: Vector,
        points_m: Sequence[ArrayLike],
        speed: str,
        blend_m: float,
        stance: ToolOrientation = KEEP_BEST_EFFORT,
    ) -> MotionPlan:
        """Plan a motion of the joints that passes points (k, 3) [m] without a stop.

        Raises:
            UnreachableError: A point is out of reach.
            OrientationError: The tool cannot stand at the last as asked.
            BadValueError: No point, no finite numbers, or no positive blend.
            UnknownNameError: No such speed.
        """
        paces, target = self.motion_limits(speed), _last_target(points_m)
        here = self._with_chain_joints(here, self._chain.clip(here[self._columns]))
        if not 0.0 < blend_m < math.inf:
            raise BadValueError("The blend", f"{blend_m} m", "a positive distance")
        goals, blends, at = list[Vector](), list[float](), here
        for point_m in points_m[:-1]:
            at = self._with_chain_joints(
                here, self._solve_orientation(at, Target(point_m), KEEP_BEST_EFFORT).solution.q
            )
            goals.append(at)
            blends.append(self._joint_blend(at, blend_m))
        standing = self._solve_orientation(at, target, stance)
        goals.append(self._with_chain_joints(here, standing.solution.q))
        plan = self._make_plan(here, JointWaypointTrajectory(here, goals, paces, blends), speed)
        return _with_target(plan, target, standing, stance)

    def plan_to_joints(
        self, here: Vector, positions: Mapping[str, float], speed: str
    ) -> MotionPlan:
        """Plan a motion of some joints, each to its position in rad (m for a prismatic one).

        Raises:
            BadValueError: No joint is named, or a position is not finite.
            UnknownNameError: No such joint or speed.
        """
        if not positions:
            raise BadValueError("The list of joints", "empty", "at least one joint")
        goal = here.copy()
        for name, position in positions.items():
            if not abs(position) <= _MAX_JOINT_STEP_RAD:
                raise BadValueError(f"The goal of {name}", position, "a number of at most 1000")
            goal[self.joint_index(name)] = position
        return self._make_plan(here, JointMove(here, goal, self.motion_limits(speed)), speed)

    def sample_path(self, plan: MotionPlan) -> Matrix:
        """Return all joints (k, n) along a plan, near enough to look for contact."""
        return self.sample_trajectory(plan.course, plan.speed)

    def sample_trajectory(self, course: Trajectory, speed: str) -> Matrix:
        """Return all joints (k, n) along a course that goes at a speed; see ``way``."""
        fastest = max(pace.speed_rad_s for pace in self.motion_limits(speed))
        return sample_path(lambda time_s: course.state(time_s).position, course.duration_s, fastest)

    def dynamic_load_factor(self, speed: str) -> float:
        """Return how many times its weight pulls the arm down where it brakes at a speed class."""
        reach_m = max(
            float(np.linalg.norm(self._chain.forward(self._model.chain_pose(pose))[:2, 3]))
            for pose in self._model.poses
        )
        return 1.0 + self._model.speed(speed).rad_s2 * reach_m / GRAVITY_M_S2

    def joint_index(self, joint: str) -> int:
        """Return where a joint stands in the vectors of plans."""
        return self._names.index(self._model.joint(joint).name)

    def tip(self, joints: Vector) -> Vector:
        """Return the tip (3,) [m] for the joints (n,)."""
        return self.tip_pose(joints)[:3, 3]

    def tip_pose(self, joints: Vector) -> Matrix:
        """Return T_base_tip (4, 4) for the joints (n,)."""
        return self._chain.forward(joints[self._columns])

    def rotation_between(self, a: Vector, b: Vector) -> float:
        """Return by how much the tool turns between joints ``a`` and ``b`` (n,), rad."""
        R_a, R_b = (self._chain.forward(joints[self._columns])[:3, :3] for joints in (a, b))
        return float(np.linalg.norm(log_so3(R_b @ R_a.T)))

    def motion_limits(self, speed: str) -> list[KinematicLimits]:
        """Return how fast each joint goes; a slide as fast as its horn turns it."""
        wanted = self._model.speed(speed)
        turning = KinematicLimits(wanted.rad_s, wanted.rad_s2, wanted.rad_s3)
        turns = (self._model.joint(name).travel_per_turn / math.tau for name in self._names)
        return [turning.scale_units(turn) for turn in turns]

    def _solve_orientation(
        self, here: Vector, target: Target, stance: ToolOrientation
    ) -> OrientationSolution:
        standing = solve_with_orientation(
            self._chain, self._tool, target, stance, here[self._columns]
        )
        if not standing.solution.reached:
            raise unreachable_error(target, standing.solution)
        return standing

    def _with_chain_joints(self, here: Vector, q: Vector) -> Vector:
        """Return all joints (n,) with those of the chain elsewhere."""
        goal = here.copy()
        goal[self._columns] = q
        return goal

    def _joint_blend(self, joints: Vector, blend_m: float) -> float:
        """Return the blend of the joints with which the tip passes a point within a distance."""
        J = self._chain.jacobian(joints[self._columns])[:3]
        return blend_m / (_PASSED * float(np.linalg.norm(J, axis=0).sum()))

    def _make_plan(self, here: Vector, course: Trajectory, speed: str) -> MotionPlan:
        position, velocity, acceleration = sample_states(course)
        goal, chain = position[-1], self._chain
        units = dict(zip(self._names, self._units, strict=True))
        near = near_limits(
            position[:, self._columns],
            chain.lower_rad,
            chain.upper_rad,
            chain.names,
            [units[name] for name in chain.names],
        )
        return MotionPlan(
            start=here,
            goal=goal,
            course=course,
            tip_m=self.tip(goal),
            path_m=path_length_m(chain, position[:, self._columns]),
            duration_s=course.duration_s,
            speed=speed,
            time_limiting_joints=tuple(
                time_limiting_joints(velocity, acceleration, self.motion_limits(speed), self._names)
            ),
            near_limits=near,
            names=tuple(self._names),
            units=self._units,
        )


def _with_target(
    plan: MotionPlan, target: Target, standing: OrientationSolution, stance: ToolOrientation
) -> MotionPlan:
    """Return the plan with where it goes."""
    return replace(
        plan,
        target_m=target.position,
        solution=standing.solution,
        orientation_error_rad=standing.left_rad,
        orientation_requested=stance.is_constrained,
    )


def _last_target(points_m: Sequence[ArrayLike]) -> Target:
    if len(points_m) == 0:
        raise BadValueError("The list of points", "empty", "at least one point")
    return Target(points_m[-1])

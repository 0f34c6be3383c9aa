"""Plans motions of one arm: to a point, on a line, through points, of single joints."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arm.planning.plan import Plan
from ikservo.arm.planning.preview import near_limits, path_length_m, states_of, time_setters
from ikservo.arm.planning.reaching import unreachable
from ikservo.arm.planning.stance import AS_IT_CAN, Stance
from ikservo.arm.planning.standing import Standing, check_stance, stand
from ikservo.errors import BadValueError
from ikservo.guard import sample_path
from ikservo.ik import Target
from ikservo.kinematics import Chain
from ikservo.kinematics.gravity import GRAVITY_M_S2
from ikservo.kinematics.se3 import Matrix, Vector, log_so3
from ikservo.model import Model
from ikservo.model.tool import tool_of
from ikservo.motion import Course, Embedded, JointMove, JointRoute, Pace, ToolRoute

__all__ = ["Planner"]

# No servo's joint goes further, many turns included.
_FURTHEST_RAD = 1000.0
# How fast the tip goes on a line at most; 0.25 m/s is what safety standards call reduced speed.
_TIP_M_S = {"slow": 0.1, "normal": 0.25, "fast": 0.5}
# The share of a blend by which a way-point is passed; see ``Rounded``.
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
        self._tool = tool_of(model)
        self._units = tuple(model.joint(name).joint_map.unit for name in names)

    def to_point(
        self, here: Vector, position_m: ArrayLike, speed: str, stance: Stance = AS_IT_CAN
    ) -> Plan:
        """Plan a motion of the tip from the joints ``here`` (n,) to a point (3,) [m].

        Raises:
            UnreachableError: No joints inside the limits reach it; carries the nearest point.
            OrientationError: The tool cannot stand there as asked.
            BadValueError: No three finite numbers.
            UnknownNameError: No such speed.
        """
        paces, target = self.paces(speed), Target(position_m)
        standing = self._stand(here, target, stance)
        goal = self._with(here, standing.solution.q)
        plan = self._plan(here, JointMove(here, goal, paces), speed)
        return _to(plan, target, standing, stance)

    def on_lines(
        self,
        here: Vector,
        points_m: Sequence[ArrayLike],
        speed: str,
        blend_m: float,
        stance: Stance = AS_IT_CAN,
    ) -> Plan:
        """Plan straight lines of the tip through points (k, 3) [m], their corners rounded.

        Raises:
            UnreachableError: The last point is out of reach, or a way to it; says where.
            OrientationError: The tool cannot stand there as asked.
            BadValueError: No point, no finite numbers, no positive blend, or a preferred posture.
            UnknownNameError: No such speed.
        """
        if stance.posture is not None:
            raise BadValueError("The stance on a line", "a posture", "how the tool stands, or none")
        paces, target = self.paces(speed), _last(points_m)
        here = self._with(here, self._chain.clip(here[self._columns]))
        standing = self._stand(here, target, replace(stance, keep=False))
        route = ToolRoute(
            self._chain,
            here[self._columns],
            points_m,
            [paces[i] for i in self._columns],
            speed_m_s=_TIP_M_S[speed],
            blend_m=blend_m,
            end=standing.solution.q if stance.asked_besides else None,
            strict=stance.keep,
        )
        solution = replace(
            standing.solution, q=route.goal, nearest_m=self._chain.forward(route.goal)[:3, 3]
        )
        left_rad = float(route.left_rad.max())
        if stance.asked_besides:
            left_rad = check_stance(self._chain, self._tool, target, stance, solution)
        plan = self._plan(here, Embedded(route, self._columns, here), speed)
        return _to(replace(plan, straight=True), target, Standing(solution, left_rad), stance)

    def through(
        self,
        here: Vector,
        points_m: Sequence[ArrayLike],
        speed: str,
        blend_m: float,
        stance: Stance = AS_IT_CAN,
    ) -> Plan:
        """Plan a motion of the joints that passes points (k, 3) [m] without a stop.

        Raises:
            UnreachableError: A point is out of reach.
            OrientationError: The tool cannot stand at the last as asked.
            BadValueError: No point, no finite numbers, or no positive blend.
            UnknownNameError: No such speed.
        """
        paces, target = self.paces(speed), _last(points_m)
        here = self._with(here, self._chain.clip(here[self._columns]))
        if not 0.0 < blend_m < math.inf:
            raise BadValueError("The blend", f"{blend_m} m", "a positive distance")
        goals, blends, at = list[Vector](), list[float](), here
        for point_m in points_m[:-1]:
            at = self._with(here, self._stand(at, Target(point_m), AS_IT_CAN).solution.q)
            goals.append(at)
            blends.append(self._blend(at, blend_m))
        standing = self._stand(at, target, stance)
        goals.append(self._with(here, standing.solution.q))
        plan = self._plan(here, JointRoute(here, goals, paces, blends), speed)
        return _to(plan, target, standing, stance)

    def to_joints(self, here: Vector, positions: Mapping[str, float], speed: str) -> Plan:
        """Plan a motion of some joints, each to its position in rad (m for a prismatic one).

        Raises:
            BadValueError: No joint is named, or a position is not finite.
            UnknownNameError: No such joint or speed.
        """
        if not positions:
            raise BadValueError("The list of joints", "empty", "at least one joint")
        goal = here.copy()
        for name, position in positions.items():
            if not abs(position) <= _FURTHEST_RAD:
                raise BadValueError(f"The goal of {name}", position, "a number of at most 1000")
            goal[self.column(name)] = position
        return self._plan(here, JointMove(here, goal, self.paces(speed)), speed)

    def way(self, plan: Plan) -> Matrix:
        """Return all joints (k, n) along a plan, near enough to look for contact."""
        return self.way_of(plan.course, plan.speed)

    def way_of(self, course: Course, speed: str) -> Matrix:
        """Return all joints (k, n) along a course that goes at a speed; see ``way``."""
        fastest = max(pace.speed_rad_s for pace in self.paces(speed))
        return sample_path(lambda time_s: course.state(time_s).position, course.duration_s, fastest)

    def load(self, speed: str) -> float:
        """Return how many times its weight pulls the arm down where it brakes at a speed class."""
        reach_m = max(
            float(np.linalg.norm(self._chain.forward(self._model.chain_pose(pose))[:2, 3]))
            for pose in self._model.poses
        )
        return 1.0 + self._model.speed(speed).rad_s2 * reach_m / GRAVITY_M_S2

    def column(self, joint: str) -> int:
        """Return where a joint stands in the vectors of plans."""
        return self._names.index(self._model.joint(joint).name)

    def tip(self, joints: Vector) -> Vector:
        """Return the tip (3,) [m] for the joints (n,)."""
        return self.tip_pose(joints)[:3, 3]

    def tip_pose(self, joints: Vector) -> Matrix:
        """Return T_base_tip (4, 4) for the joints (n,)."""
        return self._chain.forward(joints[self._columns])

    def turned(self, a: Vector, b: Vector) -> float:
        """Return by how much the tool turns between joints ``a`` and ``b`` (n,), rad."""
        R_a, R_b = (self._chain.forward(joints[self._columns])[:3, :3] for joints in (a, b))
        return float(np.linalg.norm(log_so3(R_b @ R_a.T)))

    def paces(self, speed: str) -> list[Pace]:
        """Return how fast each joint goes; a slide as fast as its horn turns it."""
        wanted = self._model.speed(speed)
        turning = Pace(wanted.rad_s, wanted.rad_s2, wanted.rad_s3)
        turns = (self._model.joint(name).travel_per_turn / math.tau for name in self._names)
        return [turning.scaled(turn) for turn in turns]

    def _stand(self, here: Vector, target: Target, stance: Stance) -> Standing:
        standing = stand(self._chain, self._tool, target, stance, here[self._columns])
        if not standing.solution.reached:
            raise unreachable(target, standing.solution)
        return standing

    def _with(self, here: Vector, q: Vector) -> Vector:
        """Return all joints (n,) with those of the chain elsewhere."""
        goal = here.copy()
        goal[self._columns] = q
        return goal

    def _blend(self, joints: Vector, blend_m: float) -> float:
        """Return the blend of the joints with which the tip passes a point within a distance."""
        J = self._chain.jacobian(joints[self._columns])[:3]
        return blend_m / (_PASSED * float(np.linalg.norm(J, axis=0).sum()))

    def _plan(self, here: Vector, course: Course, speed: str) -> Plan:
        position, velocity, acceleration = states_of(course)
        goal, chain = position[-1], self._chain
        units = dict(zip(self._names, self._units, strict=True))
        near = near_limits(
            position[:, self._columns],
            chain.lower_rad,
            chain.upper_rad,
            chain.names,
            [units[name] for name in chain.names],
        )
        return Plan(
            start=here,
            goal=goal,
            course=course,
            tip_m=self.tip(goal),
            path_m=path_length_m(chain, position[:, self._columns]),
            duration_s=course.duration_s,
            speed=speed,
            setters=tuple(time_setters(velocity, acceleration, self.paces(speed), self._names)),
            near=near,
            names=tuple(self._names),
            units=self._units,
        )


def _to(plan: Plan, target: Target, standing: Standing, stance: Stance) -> Plan:
    """Return the plan with where it goes."""
    return replace(
        plan,
        target_m=target.position,
        solution=standing.solution,
        left_rad=standing.left_rad,
        orientation_requested=stance.asked,
    )


def _last(points_m: Sequence[ArrayLike]) -> Target:
    if len(points_m) == 0:
        raise BadValueError("The list of points", "empty", "at least one point")
    return Target(points_m[-1])

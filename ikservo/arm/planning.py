"""What a motion would be before it starts: the goal, the tip there, the time it takes."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError, UnreachableError
from ikservo.ik import Result, Target, solve
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector
from ikservo.model import Model
from ikservo.motion import JointMove, Pace

__all__ = ["Plan", "Planner"]

# No joint turns further than this between two looks at what the body comes near.
_LOOK_RAD = 0.05
# No servo's joint goes further, many turns included.
_FURTHEST_RAD = 1000.0


@dataclass(frozen=True, slots=True, eq=False)
class Plan:
    """A motion that could start now.

    Attributes:
        goal: Where all joints would end (n,), rad or m.
        tip_m: Where that puts the tip (3,), metres.
        duration_s: How long it takes.
        speed: slow, normal or fast.
        target_m: The point it goes to (3,); None for a motion of joints.
        solution: What the solver answered; None for a motion of joints.
    """

    goal: Vector
    tip_m: Vector
    duration_s: float
    speed: str
    target_m: Vector | None = None
    solution: Result | None = None


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

    def to_point(self, here: Vector, position_m: ArrayLike, speed: str) -> Plan:
        """Plan a motion of the tip from the joints ``here`` (n,) to a point (3,) [m].

        Raises:
            UnreachableError: No joints inside the limits reach it; carries the nearest point.
            BadValueError: No three finite numbers.
            UnknownNameError: No such speed.
        """
        self._model.speed(speed)
        target = Target(position_m)
        solution = solve(self._chain, target, here[self._columns])
        if not solution.reached:
            raise self._unreachable(target, solution, self.tip(here))
        goal = here.copy()
        goal[self._columns] = solution.q
        return self._plan(here, goal, speed, target.position, solution)

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
        return self._plan(here, goal, speed)

    def way(self, here: Vector, plan: Plan) -> list[Vector]:
        """Return the chain's joints (dof,) along a plan that starts at ``here`` (n,)."""
        move = JointMove(here, plan.goal, self.paces(plan.speed))
        return [joints[self._columns] for joints in move.way(_LOOK_RAD)]

    def column(self, joint: str) -> int:
        """Return where a joint stands in the vectors of plans."""
        return self._names.index(self._model.joint(joint).name)

    def tip(self, joints: Vector) -> Vector:
        """Return the tip (3,) [m] for the joints (n,)."""
        return self._chain.forward(joints[self._columns])[:3, 3]

    def paces(self, speed: str) -> list[Pace]:
        """Return how fast each joint goes; a slide as fast as its horn turns it."""
        wanted = self._model.speed(speed)
        turning = Pace(wanted.rad_s, wanted.rad_s2, wanted.rad_s3)
        turns = (self._model.joint(name).travel_per_turn / math.tau for name in self._names)
        return [turning.scaled(turn) for turn in turns]

    def _plan(
        self,
        here: Vector,
        goal: Vector,
        speed: str,
        target_m: Vector | None = None,
        solution: Result | None = None,
    ) -> Plan:
        duration_s = JointMove(here, goal, self.paces(speed)).duration_s
        return Plan(goal, self.tip(goal), duration_s, speed, target_m, solution)

    def _unreachable(self, target: Target, solution: Result, tip_m: Vector) -> UnreachableError:
        """Say how near the arm can come, and offer a point in whole millimetres that it reaches."""
        nearest_m = solution.nearest_m
        return UnreachableError(
            target.position.tolist(),
            nearest_m.tolist(),
            [str(limit) for limit in solution.binding],
            self._instead(nearest_m, tip_m, solution.q),
        )

    def _instead(self, nearest_m: Vector, tip_m: Vector, q: Vector) -> list[float] | None:
        """Step back from the edge towards where the tip is until a round point is reachable."""
        for share in (0.0, 0.01, 0.02, 0.05, 0.1, 0.2):
            point_m = np.round(nearest_m + share * (tip_m - nearest_m), 3)
            if solve(self._chain, Target(point_m), q, restarts=4).reached:
                return [float(x) for x in point_m]
        return None

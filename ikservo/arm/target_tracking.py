"""Targets solved one after the other: points, poses and joints on one branch of solutions."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arm.arguments import parse_joint_positions
from ikservo.errors import BadValueError
from ikservo.ik import Solver, Target
from ikservo.kinematics import Chain, JointIndex, finite_array
from ikservo.kinematics.arrays import Matrix, Vector, as_floats
from ikservo.kinematics.se3 import exp_so3

__all__ = ["CartesianOrJointTarget", "TargetTracker"]

CartesianOrJointTarget = Target | Mapping[str, float] | ArrayLike
"""A ``Target``, a point (3,) [m], a pose (4, 4) of the tip, or positions by joint [rad or m]."""

_MAX_POSITION = 1000.0


class TargetTracker:
    """Solves targets one after the other, each from the last solution, so that the branch stays.

    Where a limit is in the way the joints go as near as they can.

    Args:
        chain: Base to tip.
        index: All joints in the order of the vectors (n,).
    """

    def __init__(self, chain: Chain, index: JointIndex) -> None:
        self._chain, self._index = chain, index
        self._solvers: dict[tuple[object, ...], Solver] = {}

    def solve_joints(self, target: CartesianOrJointTarget, last: Vector) -> tuple[Vector, bool]:
        """Return the joints (n,) for a target, from the last ones, and whether they reach it.

        Raises:
            BadValueError: It is no target, or a number in it is not finite.
            UnknownNameError: It names a joint or a link that the arm does not have.
        """
        if isinstance(target, Mapping):
            return self._joints_from_names(parse_joint_positions(target), last), True
        parsed, T = self._target_and_pose(target)
        q, reached = self._solver_for(parsed).track(T, self._index.chain_joints(last))
        return self._index.with_chain(last, q), reached

    def _joints_from_names(self, positions: Mapping[str, float], last: Vector) -> Vector:
        goal = last.copy()
        for name, position in positions.items():
            column = self._index.column(name)
            if not abs(position) <= _MAX_POSITION:
                raise BadValueError(f"The goal of {name}", position, "a number of at most 1000")
            goal[column] = position
        return goal

    def _target_and_pose(self, target: Target | ArrayLike) -> tuple[Target, Matrix]:
        """Compute a target and the pose (4, 4) for the solver."""
        target = target if isinstance(target, Target) else _parse_target(target)
        T = np.eye(4)
        T[:3, 3] = target.position
        T[:3, :3] = (
            exp_so3(target.orientation_error(np.eye(3)))
            if target.rotation is None
            else target.rotation
        )
        return target, T

    def _solver_for(self, target: Target) -> Solver:
        kind = "position" if target.only_position else "direction"
        kind = "pose" if target.rotation is not None else kind
        offset = None if target.offset_m is None else tuple(np.asarray(target.offset_m).tolist())
        axis = tuple(target.axis.tolist()) if kind == "direction" else (0.0, 0.0, 1.0)
        key = (kind, target.frame, offset, axis)
        if key not in self._solvers:
            self._solvers[key] = Solver(
                self._chain, kind, tool_axis=axis, frame=target.frame, offset_m=offset
            )
        return self._solvers[key]


def _parse_target(target: ArrayLike) -> Target:
    """Parse the target that an array is.

    Raises:
        BadValueError: It is none.
    """
    array = as_floats(target, "The target", "a point (3,), a pose (4, 4), joints or a Target")
    if array.shape != (4, 4):
        return Target(array)
    T = finite_array(array, (4, 4), "The target pose")
    return Target(T[:3, 3], orientation=T[:3, :3])

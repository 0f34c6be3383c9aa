"""Solve targets in sequence: points, poses and joint positions on one branch of solutions."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arguments import parse_joint_positions
from ikservo.errors import BadValueError, UnknownNameError
from ikservo.ik import Solver, Target
from ikservo.kinematics import Chain, JointIndex, finite_array
from ikservo.kinematics.arrays import Matrix, Vector, as_floats
from ikservo.kinematics.se3 import exp_so3, make_pose

CartesianOrJointTarget = Target | Mapping[str, float] | ArrayLike
"""A ``Target``, a point (3,) [m], a pose (4, 4) of the tip, or positions by joint [rad or m]."""

_MAX_POSITION = 1000.0


class TargetTracker:
    """Solver of targets in sequence, each from the last solution, so that the branch is kept.

    If a limit is in the way, the joints move as close to the target as they can.
    """

    def __init__(self, chain: Chain, index: JointIndex) -> None:
        self._chain, self._index = chain, index
        self._solvers: dict[tuple[object, ...], Solver] = {}

    def solve_joints(self, target: CartesianOrJointTarget, last: Vector) -> tuple[Vector, bool]:
        """Find the joints (n,) for a target from the last joints; return whether they reach it.

        Raises:
            BadValueError: The value is not a target, or a number in it is not finite.
            UnknownNameError: The target names a joint or a link that the arm does not have.
        """
        parsed = parse_target(target, self._index.names)
        if isinstance(parsed, Mapping):
            goal = last.copy()
            for name, position in parsed.items():
                column = self._index.column(name)
                if not abs(position) <= _MAX_POSITION:
                    raise BadValueError(f"The goal of {name}", position, "a number within ±1000")
                goal[column] = position
            return goal, True
        R = parsed.rotation
        if R is None:
            R = exp_so3(parsed.orientation_error(np.eye(3)))
        T = make_pose(parsed.position, R)
        q, reached = self._solver_for(parsed).track(T, self._index.chain_joints(last))
        return self._index.with_chain(last, q), reached

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


def parse_target(target: CartesianOrJointTarget, names: Sequence[str]) -> Target | dict[str, float]:
    """Parse a target of ``Arm.follow``.

    Args:
        target: A ``Target``, a point (3,) [m], a pose (4, 4), or positions by joint [rad or m].
        names: Names of all joints.

    Raises:
        BadValueError: The target has none of these forms, or a number is not finite.
        UnknownNameError: There is no such joint.
    """
    if isinstance(target, Target):
        return target
    if isinstance(target, Mapping):
        return _finite_positions(target, names)
    array = as_floats(target, "The target", "a point (3,), a pose (4, 4), joints or a Target")
    if array.shape != (4, 4):
        return Target(array)
    T = finite_array(array, (4, 4), "The target pose")
    return Target(T[:3, 3], orientation=T[:3, :3])


def parse_setpoint(
    setpoint: CartesianOrJointTarget, names: Sequence[str]
) -> Target | dict[str, float] | Matrix:
    """Parse a setpoint for ``Arm.stream``.

    Args:
        setpoint: Positions by joint, or of all joints (n,) [rad or m], a pose (4, 4) or a
            ``Target``.
        names: Names of all joints.

    Raises:
        BadValueError: The setpoint has none of these forms, or a number is not finite.
        UnknownNameError: There is no such joint.
    """
    if isinstance(setpoint, Target):
        return setpoint
    if isinstance(setpoint, Mapping):
        return _finite_positions(setpoint, names)
    expected = f"positions by joint or ({len(names)},), a pose (4, 4), or a Target"
    array = as_floats(setpoint, "The setpoint", expected)
    if array.shape == (4, 4):
        return finite_array(array, (4, 4), "The setpoint").copy()
    if array.shape != (len(names),):
        raise BadValueError("The setpoint", f"of shape {array.shape}", expected)
    return _finite_positions(dict(zip(names, array.tolist(), strict=True)), names)


def _finite_positions(positions: object, names: Sequence[str]) -> dict[str, float]:
    given = parse_joint_positions(positions)
    for name, position in given.items():
        if name not in names:
            raise UnknownNameError("joint", name, names)
        if not np.isfinite(position):
            raise BadValueError(f"The goal of {name}", position, "a finite number")
    return given

"""What a stream of wishes may consist of, and the joints each of them leads to."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arm.given import joint_positions
from ikservo.errors import BadValueError, UnknownNameError
from ikservo.ik import Solver, Target
from ikservo.kinematics import Chain, finite_array
from ikservo.kinematics.numbers import numbers
from ikservo.kinematics.se3 import Matrix, Vector, exp_so3

__all__ = ["Tracker", "Wish"]

Wish = Target | Mapping[str, float] | ArrayLike
"""A ``Target``, a point (3,) [m], a pose (4, 4) of the tip, or positions by joint [rad or m]."""

_FURTHEST = 1000.0


class Tracker:
    """Turns wishes into joints, each found from the last, so that the arm keeps its branch.

    Where a limit is in the way the joints go as near as they can.

    Args:
        chain: Base to tip.
        names: All joints in the order of the vectors (n,).
    """

    def __init__(self, chain: Chain, names: Sequence[str]) -> None:
        self._chain, self._names = chain, list(names)
        self._columns = [self._names.index(name) for name in chain.names]
        self._solvers: dict[tuple[object, ...], Solver] = {}

    def joints(self, wish: Wish, last: Vector) -> tuple[Vector, bool]:
        """Return the joints (n,) for a wish, from those for the one before, and whether they reach.

        Raises:
            BadValueError: It is no wish, or a number in it is not finite.
            UnknownNameError: It names a joint or a link that the arm does not have.
        """
        if isinstance(wish, Mapping):
            return self._named(joint_positions(wish), last), True
        target, T = self._asked(wish)
        solver = self._solver(target)
        q, reached = solver.track(T, last[self._columns])
        goal = last.copy()
        goal[self._columns] = q
        return goal, reached

    def _named(self, positions: Mapping[str, float], last: Vector) -> Vector:
        goal = last.copy()
        for name, position in positions.items():
            if name not in self._names:
                raise UnknownNameError("joint", name, self._names)
            if not abs(position) <= _FURTHEST:
                raise BadValueError(f"The goal of {name}", position, "a number of at most 1000")
            goal[self._names.index(name)] = position
        return goal

    def _asked(self, wish: Target | ArrayLike) -> tuple[Target, Matrix]:
        """Return what is asked and the pose (4, 4) that stands for it."""
        target = wish if isinstance(wish, Target) else _target(wish)
        T = np.eye(4)
        T[:3, 3] = target.position
        T[:3, :3] = (
            exp_so3(target.turn_left(np.eye(3))) if target.rotation is None else target.rotation
        )
        return target, T

    def _solver(self, target: Target) -> Solver:
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


def _target(wish: ArrayLike) -> Target:
    """Return the target that an array means.

    Raises:
        BadValueError: It means none.
    """
    array = numbers(wish, "The target", "a point (3,), a pose (4, 4), joints or a Target")
    if array.shape != (4, 4):
        return Target(array)
    T = finite_array(array, (4, 4), "The target pose")
    return Target(T[:3, 3], orientation=T[:3, :3])

"""Ways of the joints around what is in their straight way."""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ikservo.arm.context import ArmContext
from ikservo.guard import ClearSpace
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.motion.avoidance import find_way

__all__ = ["BLENDS_RAD", "HOW_TO_SEARCH", "postures_nearby", "ways_around"]

BLENDS_RAD = (0.3, 0.1, 0.03, 0.01, 0.003)
"""How far before a corner the joints may begin to turn, from the roundest way to the closest."""

HOW_TO_SEARCH = "To go around it, install a planner: pip install 'ikservo[plan]'."

# Distances that are kept from everything, and how many motions are looked at for each.
_MARGINS_M = ((0.01, 3000), (0.003, 20000))


# Postures tried around one in contact, up to so far in any joint; the fraction of joints that move.
_TRIED, _AROUND_RAD, _MOVING = 20000, 2.5, 0.6


class _MovingSpace:
    """The space of those joints that move, in radians of their horns."""

    def __init__(
        self, context: ArmContext, space: ClearSpace, at: Vector, columns: list[int], units: Vector
    ) -> None:
        self._index, self._space, self._at = context.index, space, at
        self._columns, self._units = columns, units

    def is_free(self, path: Matrix) -> bool:
        return self._space.is_free(self._index.body_joints(self.joints(path)))

    def contains(self, postures: Matrix) -> NDArray[np.bool_]:
        return self._space.contains(self._index.body_joints(self.joints(postures)))

    def joints(self, path: Matrix) -> Matrix:
        """Return all joints (k, n), rad or m."""
        joints = np.tile(self._at, (len(path), 1))
        joints[:, self._columns] = path * self._units
        return joints


def ways_around(
    context: ArmContext, start: Vector, goals: Matrix, load_factor: float
) -> Iterator[Matrix]:
    """Find postures (k, n) through which straight motions of the joints reach a goal.

    Args:
        context: The arm, whose paths are checked.
        start: All joints (n,), touching nothing.
        goals: Where the motion may end (m, n).
        load_factor: Multiple of gravity while the arm brakes.

    Yields:
        Ways that keep less and less distance; none where OMPL finds none.
    """
    checker = context.checked_collision
    if checker is None:
        return
    travels = [context.model.joint(name).travel_per_turn for name in context.index.names]
    moving = (goals != start).any(axis=0)
    moving[list(context.index.chain)] = True
    columns = np.flatnonzero(moving).tolist()
    units = np.array(travels)[columns] / math.tau
    lower, upper = (np.array(limit)[columns] / units for limit in context.limits())
    bodies = context.index.body_joints(goals)
    goals = goals[checker.distances_with_sag(bodies, load_factor).min(axis=1) >= 0.0]
    ends = context.index.body_joints(np.vstack([start, goals]))
    for margin_m, most in _MARGINS_M if len(goals) else ():
        space = checker.clear_space(margin_m, ends, load_factor)
        moving_space = _MovingSpace(context, space, start, columns, units)
        way = find_way(
            moving_space, start[columns] / units, goals[:, columns] / units, lower, upper, most=most
        )
        if way is not None:
            joints = moving_space.joints(way)
            joints[0] = start
            yield joints


def postures_nearby(context: ArmContext, start: Vector, load_factor: float) -> Iterator[Vector]:
    """Yield joints (n,) that touch nothing, those nearest to ``start`` (n,) first.

    Joints beside the chain keep their positions.
    """
    checker = context.checked_collision
    if checker is None:
        return
    random, index = np.random.default_rng(1), context.index
    at = index.chain_joints(start)
    lower, upper = (index.chain_joints(limit) for limit in context.limits())
    shape = (_TRIED, len(at))
    step = random.uniform(-1.0, 1.0, shape) * random.uniform(0.0, _AROUND_RAD, (_TRIED, 1))
    step *= random.random(shape) < _MOVING
    joints = np.tile(start, (_TRIED, 1))
    joints[:, list(index.chain)] = np.clip(at + step, np.minimum(lower, at), np.maximum(upper, at))
    joints = joints[np.argsort(np.abs(joints - start).max(axis=1))]
    space = checker.clear_space(_MARGINS_M[-1][0], load=load_factor)
    yield from joints[space.contains(index.body_joints(joints))]

"""Ways of the joints around what is in their straight way."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ikservo.guard import ClearSpace, sample_line
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.motion.avoidance import find_way
from ikservo.planning.context import ArmContext
from ikservo.planning.path_constraint import ConstrainedTool

BLENDS_RAD = (0.3, 0.1, 0.03, 0.01, 0.003)
"""How far before a corner the joints may begin to turn, from the roundest way to the closest."""

HOW_TO_SEARCH = "To go around it, install a planner: pip install 'ikservo[plan]'."

# Distances that are kept from everything, and how many motions are looked at for each.
_MARGINS_M = ((0.01, 300), (0.003, 1000), (0.0003, 300), (0.003, 20000), (0.0003, 20000))

# A motion further than this breaks a constraint more often than it touches something, which is
# then looked at second.
_LONG_RAD = 0.3

# Postures tried around one in contact, up to so far in any joint; the fraction of joints that move.
_TRIED, _AROUND_RAD, _MOVING = 20000, 2.5, 0.6


class _MovingSpace:
    """The space of those joints that move, in radians of their horns."""

    def __init__(
        self,
        context: ArmContext,
        space: ClearSpace,
        at: Vector,
        columns: list[int],
        units: Vector,
        tool: ConstrainedTool | None,
    ) -> None:
        self._index, self._space, self._at = context.index, space, at
        self._columns, self._units, self._tool = columns, units, tool
        self._body = context.index.body_joints(at)
        self._of_body = [i for i, column in enumerate(context.index.body) if column in columns]
        moved = [columns.index(context.index.body[i]) for i in self._of_body]
        self._moved, self._moved_units = moved, units[moved]
        self._of_chain = [columns.index(column) for column in context.index.chain]
        self._chain_units = units[self._of_chain]

    def is_free(self, path: Matrix) -> bool:
        if np.abs(path[-1] - path[0]).max() > _LONG_RAD:
            return self._keeps_along(path) and self._space.is_free(self._bodies(path))
        return self._space.is_free(self._bodies(path)) and self._keeps_along(path)

    def contains(self, postures: Matrix) -> NDArray[np.bool_]:
        free = self._space.contains(self._bodies(postures))
        if self._tool is not None:
            free &= self._tool.keeps(self._chains(postures))
        return free

    def _keeps_along(self, path: Matrix) -> bool:
        """Return whether the constraint is kept on the straight motions through postures."""
        if self._tool is None:
            return True
        chains = self._chains(path)
        dense = np.vstack([sample_line(a, b) for a, b in itertools.pairwise(chains)])
        return bool(self._tool.keeps(dense).all())

    def _chains(self, path: Matrix) -> Matrix:
        """Return the joints of the chain (k, dof), as ``_bodies``."""
        return path[:, self._of_chain] * self._chain_units

    def _bodies(self, path: Matrix) -> Matrix:
        """Return the joints of the body (k, m): the same as of ``joints``, in less time."""
        bodies = np.empty((len(path), len(self._body)))
        bodies[:] = self._body
        bodies[:, self._of_body] = path[:, self._moved] * self._moved_units
        return bodies

    def project(self, posture: Vector) -> Vector | None:
        """Find a posture nearby at which the tool keeps its constraint; None without one."""
        joints = self.joints(posture[None])[0]
        found = None if self._tool is None else self._tool.project(self._index.chain_joints(joints))
        if found is None:
            return None
        return self._index.with_chain(joints, found)[self._columns] / self._units

    def joints(self, path: Matrix) -> Matrix:
        """Return all joints (k, n), rad or m."""
        joints = np.tile(self._at, (len(path), 1))
        joints[:, self._columns] = path * self._units
        return joints


def ways_around(
    context: ArmContext,
    start: Vector,
    goals: Matrix,
    load_factor: float,
    tool: ConstrainedTool | None = None,
) -> Iterator[Matrix]:
    """Find postures (k, n) through which straight motions of the joints reach a goal.

    Args:
        context: The arm, whose paths are checked.
        start: All joints (n,), touching nothing.
        goals: Where the motion may end (m, n).
        load_factor: Multiple of gravity while the arm brakes.
        tool: What the tool keeps to on the way.

    Yields:
        Ways that keep less and less distance; none where OMPL finds none.

    Raises:
        StoppedError: The arm was stopped meanwhile.
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
    stop = context.servos.stop_request
    for margin_m, most in _MARGINS_M if len(goals) else ():
        space = checker.clear_space(margin_m, ends, load_factor)
        moving_space = _MovingSpace(context, space, start, columns, units, tool)
        way = find_way(
            moving_space,
            start[columns] / units,
            goals[:, columns] / units,
            lower,
            upper,
            most=most,
            project=None if tool is None else moving_space.project,
            is_over=stop.is_request_over,
        )
        stop.check_request()
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

"""Joint-space paths around obstacles on the straight path, and paths through another pose."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count

import numpy as np

from ikservo.guard.path_search import WaySearch
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.motion import ConcatenatedTrajectory
from ikservo.planning.context import ArmContext
from ikservo.planning.motion_plan import MotionPlan
from ikservo.planning.path_constraint import ConstrainedTool

BLENDS_RAD = (0.3, 0.1, 0.03, 0.01, 0.003)
"""Distances before a corner at which joints may begin to turn, the largest first [rad]."""

MARGINS_M = (0.01, 0.003, 0.0003)
"""Clearances of paths from all obstacles, the largest first [m]."""

RETRACT_POSES = ("home", "rest")
"""Retract poses to try, in this order; every arm file has them."""

_EFFORT = 1000  # postures checked with one clearance before the next; doubles in each round
_WIDE_EFFORT = 500  # the same for the largest clearance: if a path with it exists, it is found soon
_WIDE_ROUNDS = 2  # rounds after which the largest clearance is left out

_TRIED = 20000  # number of postures to try around a contact
_AROUND_RAD = 2.5  # largest offset of a joint in these postures, rad or m
_MOVING = 0.6  # fraction of the joints that are offset


def ways_around(
    context: ArmContext,
    start: Vector,
    goals: Matrix,
    load_factor: float,
    tool: ConstrainedTool | None = None,
    is_over: Callable[[], bool] = bool,
    *,
    takes_time: bool = False,
) -> Iterator[Matrix]:
    """Yield paths around obstacles: postures (k, n) connected by straight joint motions.

    The start (n,) is collision-free; the goals (m, n) are possible ends of the path. With
    ``takes_time``, a path is shortened until ``is_over``, which is called often, ends the search.

    Yields:
        Paths with decreasing clearance, until the search ends.

    Raises:
        StoppedError: The arm was stopped meanwhile.
    """
    checker, index = context.checked_collision, context.index
    if checker is None:
        return
    travels = [context.model.joint(name).travel_per_turn for name in index.names]
    moving = (goals != start).any(axis=0)
    moving[list(index.chain)] = True
    columns = np.flatnonzero(moving).tolist()
    units = np.array(travels)[columns] / math.tau
    body = np.array([
        [columns.index(column), units[columns.index(column)], 0.0] if column in columns
        else [-1.0, 1.0, start[column]]
        for column in index.body
    ])  # fmt: skip
    of_chain = np.array([[columns.index(each), units[columns.index(each)]] for each in index.chain])
    lower, upper = (np.array(limit)[columns] / units for limit in context.limits())
    near_m = checker.distances_with_sag(index.body_joints(goals), load_factor).min(axis=1)
    goals = goals[near_m >= 0.0]
    if not len(goals):
        return
    ends, stop = index.body_joints(np.vstack([start, goals])), context.servos.stop_request

    def search_at(margin_m: float) -> WaySearch:
        return WaySearch(
            checker.clear_space(margin_m, ends, load_factor),
            start[columns] / units,
            goals[:, columns] / units,
            lower,
            upper,
            body=body,
            tool=tool,
            columns=of_chain,
            takes_time=takes_time,
        )

    searches = dict[float, WaySearch]()
    for n in count():
        for margin_m in MARGINS_M if n < _WIDE_ROUNDS else MARGINS_M[1:]:
            effort = _WIDE_EFFORT if margin_m == MARGINS_M[0] else _EFFORT
            search = searches[margin_m] = searches.get(margin_m) or search_at(margin_m)
            way = search.find(effort * 2**n, lambda: stop.is_request_over() or is_over())
            stop.check_request()
            if way is not None:
                joints = np.tile(start, (len(way), 1))
                joints[:, columns] = way * units
                joints[0] = start
                yield joints
        if is_over() or all(searches[margin_m].has_ended for margin_m in MARGINS_M[1:]):
            return


def postures_nearby(context: ArmContext, start: Vector, load_factor: float) -> Iterator[Vector]:
    """Yield collision-free postures (n,), the nearest to ``start`` (n,) first.

    Joints outside the chain keep their positions.
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
    space = checker.clear_space(MARGINS_M[-1], load=load_factor)
    yield from joints[space.contains(index.body_joints(joints))]


def via_pose_plan(
    first: MotionPlan, then: MotionPlan, pose: str, orientation_change_rad: float
) -> MotionPlan:
    """Return a plan that moves to a pose, stops there, and continues from it.

    The change of orientation is measured from the start of ``first`` to the goal of ``then``.
    """
    return replace(
        then,
        start=first.start,
        orientation_change_rad=orientation_change_rad,
        trajectory=ConcatenatedTrajectory(first.trajectory, then.trajectory),
        path_m=first.path_m + then.path_m,
        duration_s=first.duration_s + then.duration_s,
        time_limiting_joints=tuple(
            dict.fromkeys(first.time_limiting_joints + then.time_limiting_joints)
        ),
        via_pose=pose,
    )

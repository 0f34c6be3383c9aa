"""The search for a way of the joints around what is in their straight way.

Bidirectional: a tree of straight motions grows from the start, another from the goals, until they
meet (RRT-Connect; Kuffner and LaValle 2000), in OMPL. What was found is then shortened. One
question has one answer: chance begins at the same seed each time.
"""

from __future__ import annotations

import importlib
import threading
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ikservo.kinematics.arrays import Matrix, Vector

__all__ = ["MotionSpace", "can_search", "find_way", "path_length"]

# Cuts tried on a path, and how many in a row may fail.
_CUTS, _FAILED_CUTS = 60, 15
_REACH_RAD = 0.8  # of one motion of a tree
_SAME = 1e-9
_lock = threading.Lock()  # OMPL has one source of chance in a process


class MotionSpace(Protocol):
    """What is known of the ways between postures."""

    def is_free(self, path: Matrix) -> bool:
        """Return whether the straight motions through postures (n, dof) are free."""
        ...

    def contains(self, postures: Matrix) -> NDArray[np.bool_]:
        """Return for each posture (n, dof) whether it is free (n,)."""
        ...


def can_search() -> bool:
    """Return whether OMPL is installed."""
    try:
        importlib.import_module("ompl.base")
    except ImportError:
        return False
    return True


def path_length(path: Matrix) -> float:
    """Compute the length of straight motions through postures (k, n), rad."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


def find_way(
    space: MotionSpace,
    start: Vector,
    goals: Matrix,
    lower: Vector,
    upper: Vector,
    *,
    most: int = 20000,
    seed: int = 1,
) -> Matrix | None:
    """Find postures (k, n) through which straight motions lead from a start to one of some goals.

    Args:
        space: What is free.
        start: Where they begin (n,).
        goals: Where they may end (m, n).
        lower: The lowest positions (n,), finite.
        upper: The highest positions (n,).
        most: How many motions are looked at, at most: a hundred take some 10 ms.
        seed: Where chance begins, above 0.

    Returns:
        None where none was found, or the start or all goals are not free.
    """
    inside = (goals >= lower - _SAME).all(axis=1) & (goals <= upper + _SAME).all(axis=1)
    goals = goals[inside & space.contains(goals)] if len(goals) else goals
    if not len(goals) or not space.contains(start[None])[0]:
        return None
    for goal in goals:
        if space.is_free(np.array([start, goal])):
            return np.array([start, goal])
    path = _search(space, start, goals, lower, upper, most, seed)
    return None if path is None else _shortened(space, path, np.random.default_rng(seed))


def _search(
    space: MotionSpace,
    start: Vector,
    goals: Matrix,
    lower: Vector,
    upper: Vector,
    most: int,
    seed: int,
) -> Matrix | None:
    ob: Any = importlib.import_module("ompl.base")
    og: Any = importlib.import_module("ompl.geometric")
    ou: Any = importlib.import_module("ompl.util")
    columns, looked_at = range(len(start)), 0

    class Validity(ob.StateValidityChecker):  # pyright: ignore[reportUntypedBaseClass]
        def isValid(self, state: Any) -> bool:  # noqa: ANN401, N802
            return bool(space.contains(np.array([[state[k] for k in columns]]))[0])

    class Motions(ob.MotionValidator):  # pyright: ignore[reportUntypedBaseClass]
        def checkMotion(self, a: Any, b: Any) -> bool:  # noqa: ANN401, N802
            nonlocal looked_at
            looked_at += 1
            return space.is_free(np.array([[a[k] for k in columns], [b[k] for k in columns]]))

    with _lock:
        ou.setLogLevel(ou.LogLevel.LOG_NONE)
        ou.RNG.setSeed(seed)
        joints = ob.RealVectorStateSpace(len(start))
        bounds = ob.RealVectorBounds(len(start))
        for k in columns:
            bounds.setLow(k, float(min(lower[k], start[k])))
            bounds.setHigh(k, float(max(upper[k], start[k])))
        joints.setBounds(bounds)
        about = ob.SpaceInformation(joints)
        about.setStateValidityChecker(Validity(about))
        about.setMotionValidator(Motions(about))
        about.setup()

        def state_at(q: Vector) -> Any:  # noqa: ANN401
            state = about.allocState()
            for k in columns:
                state[k] = float(q[k])
            return state

        question = ob.ProblemDefinition(about)
        question.addStartState(state_at(start))
        ends = ob.GoalStates(about)
        for goal in goals:
            ends.addState(state_at(goal))
        question.setGoal(ends)
        planner = og.RRTConnect(about)
        planner.setRange(_REACH_RAD)
        planner.setProblemDefinition(question)
        planner.setup()
        planner.solve(ob.PlannerTerminationCondition(lambda: looked_at >= most))
        if not question.hasExactSolution():
            return None
        states = question.getSolutionPath().getStates()
        return np.array([[state[k] for k in columns] for state in states])


def _shortened(space: MotionSpace, path: Matrix, random: np.random.Generator) -> Matrix:
    """Return a path (k, n) without the detours that a straight motion saves."""
    path, failed = _without_corners(space, path), 0
    for _ in range(_CUTS):
        if len(path) == 2 or failed == _FAILED_CUTS:
            break
        at = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(path, axis=0), axis=1))])
        first, second = np.sort(random.uniform(0.0, at[-1], 2))
        i, j = np.searchsorted(at, [first, second], side="right") - 1
        cut = np.array([_between(path, at, i, first), _between(path, at, j, second)])
        failed += 1
        if i < j and space.is_free(cut):
            path, failed = np.vstack([path[: i + 1], cut, path[j + 1 :]]), 0
    return _without_corners(space, path)


def _between(path: Matrix, at: Vector, i: int, distance: float) -> Vector:
    return path[i] + (distance - at[i]) / (at[i + 1] - at[i]) * (path[i + 1] - path[i])


def _without_corners(space: MotionSpace, path: Matrix) -> Matrix:
    """Return a path (k, n) without the corners that straight motions leave out."""
    kept, i = [path[0]], 0
    while i < len(path) - 1:
        j = len(path) - 1
        while j > i + 1 and not space.is_free(path[[i, j]]):
            j -= 1
        kept.append(path[j])
        i = j
    return np.array(kept)

"""The search for a way of the joints around what is in their straight way.

Bidirectional: a tree of straight motions grows from the start, another from the goals, until they
meet (RRT-Connect; Kuffner and LaValle 2000), in OMPL. Where the tool is constrained, trees grow in
short steps that are projected back to where the constraint is kept (CBiRRT; Berenson and others
2009). What was found is then shortened. One question has one answer: chance begins at the same
seed each time.
"""

from __future__ import annotations

import importlib
import itertools
import threading
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from ikservo.kinematics.arrays import Matrix, Vector

# Cuts tried on a path, and how many in a row may fail.
_CUTS, _FAILED_CUTS = 60, 15
_HALVED = 8  # corners of longer paths are left out by so large a part of the rest
_REACH_RAD = 0.8  # of one motion of a tree
# Of one step of a tree that is projected; how much nearer it must come; how far it may be moved.
_STEP_RAD, _NEARER, _FURTHEST = 0.3, 0.1, 2.0
_BEYOND = 0.3  # the part of the range of a joint that is tried beyond each limit: at the limit
_SAME = 1e-9
_lock = threading.Lock()  # OMPL has one source of chance in a process


class MotionSpace(Protocol):
    """What is known of the ways between postures."""

    def is_free(self, path: Matrix) -> bool:
        """Tell whether the straight motions through postures (n, dof) are free."""
        ...

    def contains(self, postures: Matrix) -> NDArray[np.bool_]:
        """Return for each posture (n, dof) whether it is free (n,)."""
        ...


Projection = Callable[[Vector], Vector | None]
"""Returns a posture (n,) nearby that keeps a constraint; None where there is none."""


@dataclass(frozen=True, slots=True, eq=False)
class _WaySearch:
    """What is searched for; see ``find_way``."""

    space: MotionSpace
    start: Vector
    goals: Matrix
    lower: Vector
    upper: Vector
    most: int
    seed: int
    is_over: Callable[[], bool]


def can_search() -> bool:
    """Tell whether OMPL is installed."""
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
    project: Projection | None = None,
    is_over: Callable[[], bool] = bool,
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
        project: What brings a posture back to where the constraint of ``space`` is kept, if it has
            one.
        is_over: Whether the search is to end without a way; asked often.

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
    asked = _WaySearch(space, start, goals, lower, upper, most, seed, is_over)
    path = _search(asked) if project is None else _search_projected(asked, project)
    return None if path is None else _shortened(space, path, np.random.default_rng(seed))


def _search(asked: _WaySearch) -> Matrix | None:
    ob: Any = importlib.import_module("ompl.base")
    og: Any = importlib.import_module("ompl.geometric")
    ou: Any = importlib.import_module("ompl.util")
    start, columns, looked_at = asked.start, range(len(asked.start)), 0

    class Validity(ob.StateValidityChecker):  # pyright: ignore[reportUntypedBaseClass]
        def isValid(self, state: Any) -> bool:  # noqa: ANN401, N802
            return True  # the ends of a motion are looked at with it

    class Motions(ob.MotionValidator):  # pyright: ignore[reportUntypedBaseClass]
        def checkMotion(self, a: Any, b: Any) -> bool:  # noqa: ANN401, N802
            nonlocal looked_at
            looked_at += 1
            ends = np.array([[state[k] for k in columns] for state in (a, b)])
            return asked.space.is_free(ends)

    with _lock:
        ou.setLogLevel(ou.LogLevel.LOG_NONE)
        ou.RNG.setSeed(asked.seed)
        joints = ob.RealVectorStateSpace(len(start))
        bounds = ob.RealVectorBounds(len(start))
        for k in columns:
            bounds.setLow(k, float(min(asked.lower[k], start[k])))
            bounds.setHigh(k, float(max(asked.upper[k], start[k])))
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
        for goal in asked.goals:
            ends.addState(state_at(goal))
        question.setGoal(ends)
        planner = og.RRTConnect(about)
        planner.setRange(_REACH_RAD)
        planner.setProblemDefinition(question)
        planner.setup()
        planner.solve(
            ob.PlannerTerminationCondition(lambda: looked_at >= asked.most or asked.is_over())
        )
        if not question.hasExactSolution():
            return None
        states = question.getSolutionPath().getStates()
        return np.array([[state[k] for k in columns] for state in states])


class _Tree:
    """Postures, each but the roots with the one that it was reached from."""

    def __init__(self, roots: Matrix) -> None:
        self._rows, self._count = roots.copy(), len(roots)
        self._before = [-1] * len(roots)

    def __getitem__(self, i: int) -> Vector:
        return self._rows[i]

    def nearest(self, q: Vector) -> int:
        """Return the index of the posture nearest to ``q`` (n,)."""
        return int(((self._rows[: self._count] - q) ** 2).sum(axis=1).argmin())

    def add(self, q: Vector, before: int) -> int:
        """Add a posture (n,), and return its index."""
        if self._count == len(self._rows):
            self._rows = np.concatenate([self._rows, np.empty_like(self._rows)])
        self._rows[self._count] = q
        self._before.append(before)
        self._count += 1
        return self._count - 1

    def branch(self, i: int) -> list[Vector]:
        """Return the postures from one to its root."""
        found = list[Vector]()
        while i >= 0:
            found.append(self._rows[i])
            i = self._before[i]
        return found


def _search_projected(asked: _WaySearch, project: Projection) -> Matrix | None:
    random, looked_at = np.random.default_rng(asked.seed), 0

    def step(at: Vector, towards: Vector) -> Vector | None:
        left = float(np.linalg.norm(towards - at))
        if left <= _STEP_RAD:
            return towards
        new = project(at + _STEP_RAD / left * (towards - at))
        if new is None or float(np.linalg.norm(towards - new)) > left - _NEARER * _STEP_RAD:
            return None
        return new if float(np.linalg.norm(new - at)) < _FURTHEST * _STEP_RAD else None

    def grow(tree: _Tree, towards: Vector) -> int:
        nonlocal looked_at
        i = tree.nearest(towards)
        while not np.array_equal(tree[i], towards):
            looked_at += 1
            new = step(tree[i], towards)
            if new is None or not asked.space.is_free(np.array([tree[i], new])):
                break
            i = tree.add(new, i)
        return i

    trees = (_Tree(asked.start[None]), _Tree(asked.goals))
    for turn in itertools.count():
        if looked_at >= asked.most or asked.is_over():
            return None
        one, other = trees if turn % 2 == 0 else trees[::-1]
        beyond = _BEYOND * (asked.upper - asked.lower)
        aim = random.uniform(asked.lower - beyond, asked.upper + beyond)
        reached = grow(one, np.clip(aim, asked.lower, asked.upper))
        met = grow(other, one[reached])
        if np.array_equal(one[reached], other[met]):
            ends = (reached, met) if one is trees[0] else (met, reached)
            return np.array(trees[0].branch(ends[0])[::-1] + trees[1].branch(ends[1])[1:])
    return None


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
            j -= max(1, (j - i) // _HALVED)
        kept.append(path[j])
        i = j
    return np.array(kept)

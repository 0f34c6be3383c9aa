"""Other planners for the same problems: OMPL, called as in its manual, and sscbirrt.

Both check postures with our collision kernel every 0.05 rad, the default of sscbirrt; nothing is
checked between them. Both shorten their paths by methods of their own.
"""

from __future__ import annotations

import importlib
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ikservo.guard.clear_space import ClearSpace

Array = NDArray[np.float64]

_RESOLUTION_RAD = 0.05
_SEED = 1


def find_by_ompl(
    space: ClearSpace, start: Array, goal: Array, lower: Array, upper: Array, most_s: float
) -> Array | None:
    """Return postures (k, n) from a start to a goal by RRT-Connect; None if none was found."""
    ob: Any = importlib.import_module("ompl.base")
    og: Any = importlib.import_module("ompl.geometric")
    ou: Any = importlib.import_module("ompl.util")
    ou.setLogLevel(ou.LogLevel.LOG_NONE)
    ou.RNG.setSeed(_SEED)
    columns = range(len(start))

    class Validity(ob.StateValidityChecker):  # pyright: ignore[reportUntypedBaseClass]
        def isValid(self, state: Any) -> bool:  # noqa: ANN401, N802
            return bool(space.contains(np.array([[state[k] for k in columns]]))[0])

    joints = ob.RealVectorStateSpace(len(start))
    bounds = ob.RealVectorBounds(len(start))
    for k in columns:
        bounds.setLow(k, float(lower[k]))
        bounds.setHigh(k, float(upper[k]))
    joints.setBounds(bounds)
    about = ob.SpaceInformation(joints)
    about.setStateValidityChecker(Validity(about))
    about.setStateValidityCheckingResolution(_RESOLUTION_RAD / joints.getMaximumExtent())
    about.setup()
    ends = [about.allocState(), about.allocState()]
    for state, q in zip(ends, (start, goal), strict=True):
        for k in columns:
            state[k] = float(q[k])
    question = ob.ProblemDefinition(about)
    question.setStartAndGoalStates(*ends)
    planner = og.RRTConnect(about)
    planner.setProblemDefinition(question)
    planner.setup()
    planner.solve(most_s)
    if not question.hasExactSolution():
        return None
    path = question.getSolutionPath()
    og.PathSimplifier(about).simplifyMax(path)
    return np.array([[state[k] for k in columns] for state in path.getStates()])


class _Postures:
    """The robot and the checker that sscbirrt requires."""

    def __init__(self, space: ClearSpace, lower: Array, upper: Array) -> None:
        self._space = space
        self.dof, self.joint_limits = len(lower), (lower, upper)

    def is_valid(self, q: Array) -> bool:
        """Return whether a posture (n,) is free."""
        return bool(self._space.contains(np.asarray(q)[None])[0])

    def forward_kinematics(self, q: Array) -> Array:
        """Raise an error, because no region is requested."""
        raise NotImplementedError


def find_by_sscbirrt(
    space: ClearSpace, start: Array, goal: Array, lower: Array, upper: Array, most_s: float
) -> Array | None:
    """Return postures (k, n) from a start to a goal; None if none was found."""
    ss: Any = importlib.import_module("sscbirrt")
    postures = _Postures(space, lower, upper)
    settings = ss.CBiRRTConfig(timeout=most_s, edge_resolution=_RESOLUTION_RAD)
    planner = ss.CBiRRT(postures, None, postures, settings)
    question = ss.PlanningProblem(
        space=planner.space,
        start=ss.FiniteSet([start], metric=planner.space.distance),
        goal=ss.FiniteSet([goal], metric=planner.space.distance),
        validator=postures,
    )
    try:
        path = planner.solve(question, seed=_SEED).path
    except ss.PlanningError:
        return None
    return None if path is None else np.array(path)

"""Whether a solution is unique, one of several, or one of a continuous family."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from ikservo.ik.bounded import problem_for_target, target_kind_of
from ikservo.ik.closed_form import DirectionInterval, direction_intervals, solutions
from ikservo.ik.closed_form_structure import recognise_structure
from ikservo.ik.jacobian_methods import ResidualFunction, pinv
from ikservo.ik.problem import Target, Tolerance
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector

__all__ = ["SolutionSet", "solution_set"]

# Singular values below this part of the largest are none, in an ordinary posture and at a solution.
_RANK, _SINGULAR = 1e-7, 1e-6
_SAMPLES = 5
_IRRATIONAL = np.sqrt(np.array([2.0, 3.0, 5.0, 7.0, 11.0, 13.0, 17.0]))
# To see whether a solution has neighbours it is left by so much [rad] and met again nearby: one
# that stands alone draws the arm back.
_OFFSET_RAD, _STEPS, _MIN_OFFSET_FRACTION = 0.02, 10, 0.5
_TURN_RAD = 2.0 * np.pi
_SAME_RAD = 1e-4


@dataclass(frozen=True, slots=True)
class SolutionSet:
    """How many solutions a target has inside the limits.

    Joints that do not move the point, and full turns of a joint, make no solutions of their own.

    Attributes:
        kind: ``none`` found, the only ``one``, one of ``several``, one of a ``family`` that goes
            on continuously, or ``unknown`` where this is one and nobody knows of others.
        count: How many solutions, or branches of a family; None where that is not known.
        freedom: How many parameters the family has; 0 without.
        directions: The directions that the last of three links may have in a family (lecture L4).
    """

    kind: Literal["none", "one", "several", "family", "unknown"]
    count: int | None = None
    freedom: int = 0
    directions: tuple[DirectionInterval, ...] = ()

    def __str__(self) -> str:
        """Return it in words."""
        if self.kind == "none":
            return "no solution found"
        if self.kind == "one":
            return "the only solution"
        if self.kind == "several":
            return "one of several" if self.count is None else f"one of {self.count} solutions"
        if self.kind == "unknown":
            return "others not known"
        family = f"one of a {_NUMBERS.get(self.freedom, str(self.freedom))}-parameter family"
        branches = "branch" if self.count == 1 else "branches"
        return family if self.count is None else f"{family} with {self.count} {branches}"


_NUMBERS = {1: "one", 2: "two", 3: "three", 4: "four"}


def solution_set(
    chain: Chain, target: Target, q: Vector, tolerance: Tolerance | None = None
) -> SolutionSet:
    """Tell what joints (dof,) that meet a target are one of.

    Args:
        chain: The arm.
        target: What is wanted.
        q: Joints (dof,) inside the limits.
        tolerance: How close counts as met.
    """
    task, tolerance = ResidualFunction(chain, target), tolerance or Tolerance()
    here = task.linearise(q)
    if not task.is_met(here, Tolerance(2 * tolerance.position_m, 2 * tolerance.orientation_rad)):
        return SolutionSet("none", 0)
    moving = _moving_joints(chain, target)
    freedom = len(moving) - _usual_rank(task, moving)
    J = here.J[:, moving]
    ways = _null_space(J)
    if len(ways) and any(
        _continues_along(task, tolerance, q, moving, way) for way in (*ways, *-ways)
    ):
        free = max(freedom, 1)
        directions = (
            direction_intervals(chain, target, q) if _is_planar_3r(chain, target, free) else ()
        )
        return SolutionSet("family", len(directions) or None, free, directions)
    return _count_isolated(chain, target, q)


def _count_isolated(chain: Chain, target: Target, q: Vector) -> SolutionSet:
    """Count the solutions of a target that has no family of them."""
    if recognise_structure(chain, target.frame) is None:
        return SolutionSet("unknown")
    known = solutions(chain, target, q)
    if not any(
        _is_same_solution(other, q) for other in known
    ):  # the closed form does not know them all
        return SolutionSet("several" if known else "unknown")
    return SolutionSet("one" if len(known) == 1 else "several", len(known))


def _moving_joints(chain: Chain, target: Target) -> list[int]:
    idle = {
        joint.column for joint in problem_for_target(chain, target).idle[target_kind_of(target)]
    }
    return [column for column in range(chain.dof) if column not in idle]


def _usual_rank(task: ResidualFunction, moving: list[int]) -> int:
    """Return how many directions of the task the joints have in an ordinary posture."""
    angles = _TURN_RAD * ((0.5 + np.outer(np.arange(1, _SAMPLES + 1), _IRRATIONAL)) % 1.0)
    looks: Matrix = np.resize(angles, (_SAMPLES, task.chain.dof)).astype(np.float64)
    ranks = [_numerical_rank(task.linearise(q).J[:, moving], _RANK) for q in looks]
    return max(ranks)


def _numerical_rank(J: Matrix, share: float) -> int:
    values = np.linalg.svd(J, compute_uv=False)
    return int((values > share * values.max(initial=0.0)).sum())


def _null_space(J: Matrix) -> Matrix:
    """Return the ways (k, n) in which joints move without moving what is wanted."""
    _, _, Vt = np.linalg.svd(J)
    return Vt[_numerical_rank(J, _SINGULAR) :]


def _is_planar_3r(chain: Chain, target: Target, freedom: int) -> bool:
    return (
        target.only_position
        and freedom == 1
        and recognise_structure(chain, target.frame) is not None
    )


def _continues_along(
    task: ResidualFunction, tolerance: Tolerance, q: Vector, moving: list[int], way: Vector
) -> bool:
    """Return whether there are solutions beside q along a way (n,) of the moving joints."""
    chain, there = task.chain, q.copy()
    there[moving] += _OFFSET_RAD * way
    there = chain.clip(there)
    for _ in range(_STEPS):
        local = task.linearise(there)
        free = np.zeros(chain.dof, dtype=np.bool_)
        free[moving] = True
        free &= (there > chain.lower_rad) & (there < chain.upper_rad)
        step = np.zeros(chain.dof)
        step[free] = pinv(local.J[:, free], _SINGULAR) @ local.E
        there = chain.clip(there + step)
    aside = float((there[moving] - q[moving]) @ way)
    return (
        task.is_met(task.linearise(there), tolerance) and aside > _MIN_OFFSET_FRACTION * _OFFSET_RAD
    )


def _is_same_solution(a: Vector, b: Vector) -> bool:
    apart = a - b
    apart -= _TURN_RAD * np.round(apart / _TURN_RAD)
    return float(np.abs(apart).max()) < _SAME_RAD

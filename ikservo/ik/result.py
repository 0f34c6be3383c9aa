"""Result of a solve: joints, errors, active limits, and other solutions."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from ikservo.ik.problem import Target, Tolerance
from ikservo.kinematics import Chain, Conditioning, Singularity, conditioning, nearest_singularity
from ikservo.kinematics.arrays import Matrix, Vector, read_only

if TYPE_CHECKING:
    from ikservo.ik.planar import DirectionInterval

NOT_LIMITED = "link lengths or number of joints"
"""Name for the limit of an arm's reach when no joint limit is active."""


@dataclass(frozen=True, slots=True)
class ActiveLimit:
    """A joint limit that keeps the tool from coming closer to the target."""

    joint: str
    side: Literal["lower", "upper"]

    def __str__(self) -> str:
        return f"{self.joint} at its {self.side} limit"


_NUMBERS = {1: "one", 2: "two", 3: "three", 4: "four"}


@dataclass(frozen=True, slots=True)
class SolutionSet:
    """The number of solutions for a target inside the limits.

    Joints that do not move the point, and full revolutions of a joint, do not add solutions.

    Attributes:
        kind: ``none`` (no solution was found), ``one``, ``several``, a continuous ``family``, or
            ``unknown`` (there may be more solutions).
        count: The number of solutions, or branches of a family; None if it is unknown.
        freedom: The number of parameters of the family; 0 if there is none.
        directions: The possible directions of the last of three links in a family.
    """

    kind: Literal["none", "one", "several", "family", "unknown"]
    count: int | None = None
    freedom: int = 0
    directions: tuple[DirectionInterval, ...] = ()

    def __str__(self) -> str:
        """Return a description as text."""
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


class SolvedProblem(NamedTuple):
    """The arm and the target of a result, for finding other solutions."""

    chain: Chain
    target: Target
    find_solutions: Callable[[Chain, Target, Vector], SolutionSet]


@dataclass(frozen=True, eq=False)
class Result:
    """A solution, or the closest joints that the limits allow.

    Attributes:
        q: Joint vector (dof,), rad or m, always inside the limits.
        reached: Whether position and orientation are within the tolerance.
        position_error_m: Distance from the target point.
        orientation_error_rad: Angle from the target direction or orientation; 0 if only the
            position counts.
        binding: The limits that keep the arm from the target; empty if it is reached.
        iterations: Number of steps, including restarts.
        nearest_m: The point at ``q`` (3,), metres, base frame.
        method: Name of the method that found the joint positions.
        trace: Every iterate (dof,), the start first, if requested.
        question: The solved problem; None for results of a prepared solver.
    """

    q: Vector
    reached: bool
    position_error_m: float
    orientation_error_rad: float
    binding: tuple[ActiveLimit, ...]
    iterations: int
    nearest_m: Vector
    method: str
    trace: tuple[Vector, ...] = ()
    question: SolvedProblem | None = field(default=None, repr=False)

    # Written out, because the method that dataclasses generate takes twice as long.
    def __init__(
        self,
        q: Vector,
        reached: bool,
        position_error_m: float,
        orientation_error_rad: float,
        binding: tuple[ActiveLimit, ...],
        iterations: int,
        nearest_m: Vector,
        method: str,
        trace: tuple[Vector, ...] = (),
        question: SolvedProblem | None = None,
    ) -> None:
        fields = self.__dict__
        fields["q"] = read_only(q)
        fields["reached"] = reached
        fields["position_error_m"] = position_error_m
        fields["orientation_error_rad"] = orientation_error_rad
        fields["binding"] = binding
        fields["iterations"] = iterations
        fields["nearest_m"] = read_only(nearest_m)
        fields["method"] = method
        fields["trace"] = tuple(read_only(q) for q in trace)
        fields["question"] = question

    def __str__(self) -> str:
        """Return the solution and its error as text; ``repr`` shows everything."""
        q = ", ".join(f"{each:z.4f}" for each in self.q)
        held = f" ({', '.join(map(str, self.binding))})" if self.binding else ""
        off = f"{1e3 * self.position_error_m:.3f} mm, {self.orientation_error_rad:.4f} rad off"
        return f"{'reached' if self.reached else 'not reached'}: q = ({q}), {off}{held}"

    def attach_question(self, question: SolvedProblem) -> Result:
        """Attach the solved problem before the result is returned to a user; return the result."""
        self.__dict__["question"] = question
        return self

    @property
    def solutions(self) -> SolutionSet:
        """Number or family of solutions, computed when read, in a few milliseconds."""
        if not self.reached:
            return SolutionSet("none", 0)
        if self.question is None:
            return SolutionSet("unknown")
        return self.question.find_solutions(self.question.chain, self.question.target, self.q)

    @property
    def conditioning(self) -> Conditioning | None:
        """The mobility of the target's point at ``q``; None if the problem is not known."""
        if self.question is None:
            return None
        target = self.question.target
        return conditioning(self.question.chain, self.q, target.frame, target.offset_m)

    @property
    def singularity(self) -> Singularity | None:
        """The singular posture nearest to ``q``, or None; takes some tens of milliseconds.

        If the target has a direction or orientation, a lost rotation of the link also counts.
        """
        if self.question is None:
            return None
        target = self.question.target
        chain = self.question.chain
        return nearest_singularity(
            chain, self.q, target.frame, target.offset_m, rotation=not target.only_position
        )


def evaluate(
    chain: Chain,
    target: Target,
    q: Vector,
    tolerance: Tolerance,
    *,
    method: str,
    iterations: int,
    trace: tuple[Vector, ...] = (),
) -> Result:
    """Compute the errors and active limits of joints (dof,) inside the limits for a target."""
    T, J = chain.forward_and_jacobian(q, target.frame, target.offset_m)
    gap_m, rotation_rad = target.position - T[:3, 3], target.orientation_error(T[:3, :3])
    position_error_m, orientation_error_rad = _vector_norm(gap_m), _vector_norm(rotation_rad)
    met = position_error_m <= tolerance.position_m
    reached = met and orientation_error_rad <= tolerance.orientation_rad
    gradient = J[3:].T @ rotation_rad if met else J[:3].T @ gap_m
    return Result(
        q=q,
        reached=reached,
        position_error_m=position_error_m,
        orientation_error_rad=orientation_error_rad,
        binding=() if reached else _binding_limits(chain, q, gradient),
        iterations=iterations,
        nearest_m=T[:3, 3],
        method=method,
        trace=trace,
    )


def is_closer(a: Result, b: Result, tolerance: Tolerance) -> bool:
    """Check whether ``a`` is a better result than ``b``: by position, then by orientation."""
    return _rank_result(a, tolerance) < _rank_result(b, tolerance)


def _rank_result(result: Result, tolerance: Tolerance) -> tuple[float, float]:
    return max(0.0, result.position_error_m - tolerance.position_m), result.orientation_error_rad


def _binding_limits(chain: Chain, q: Vector, gradient: Vector) -> tuple[ActiveLimit, ...]:
    """Return the limits against which the remaining error pulls the joints."""
    found: list[ActiveLimit] = []
    for i, name in enumerate(chain.names):
        if q[i] <= chain.lower_rad[i] and gradient[i] < 0:
            found.append(ActiveLimit(name, "lower"))
        elif q[i] >= chain.upper_rad[i] and gradient[i] > 0:
            found.append(ActiveLimit(name, "upper"))
    return tuple(found)


def _vector_norm(v: Vector | Matrix) -> float:
    return math.sqrt(float(np.dot(v, v)))

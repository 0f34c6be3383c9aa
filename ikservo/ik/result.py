"""The result of a solve."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Literal

from ikservo.ik.problem import Target
from ikservo.kinematics import (
    Chain,
    Conditioning,
    Singularity,
    conditioning,
    nearest_singularity,
)
from ikservo.kinematics.arrays import Vector

if TYPE_CHECKING:
    from ikservo.ik.solution_set import SolutionSet

__all__ = ["NOT_LIMITED", "ActiveLimit", "Result", "SolvedProblem"]

NOT_LIMITED = "link lengths or number of joints"
"""What limits the reach of an arm where no joint limit does."""


@dataclass(frozen=True, slots=True)
class ActiveLimit:
    """A joint limit that keeps the tool from coming closer."""

    joint: str
    side: Literal["lower", "upper"]

    def __str__(self) -> str:
        return f"{self.joint} at its {self.side} limit"


@dataclass(frozen=True, slots=True, eq=False)
class SolvedProblem:
    """What a result answers: the arm and the target."""

    chain: Chain
    target: Target


@dataclass(frozen=True, slots=True, eq=False)
class Result:
    """A solution, or the closest that the limits allow (lecture L5).

    Attributes:
        q: Joint vector (dof,), rad or m, always inside the limits.
        reached: Whether position and orientation are within the tolerance.
        position_error_m: Distance from the wanted point.
        orientation_error_rad: Angle from the wanted direction or orientation; 0 if none wanted.
        binding: The limits that hold the arm back; empty when reached.
        iterations: Steps taken, restarts included.
        nearest_m: Where the point is at ``q`` (3,), metres, base frame.
        method: The solver that found it.
        trace: Every iterate (dof,), the start first, where it was asked for.
        question: What was asked; None for the answers of a prepared solver.
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

    @property
    def solutions(self) -> SolutionSet:
        """Tell whether there are other solutions; computed when it is read, in some ms."""
        from ikservo.ik.solution_set import SolutionSet, solution_set  # noqa: PLC0415  # uses us

        if not self.reached:
            return SolutionSet("none", 0)
        if self.question is None:
            return SolutionSet("unknown")
        return solution_set(self.question.chain, self.question.target, self.q)

    @property
    def conditioning(self) -> Conditioning | None:
        """Measure how freely the point moves at ``q``; None where the question is not known."""
        if self.question is None:
            return None
        asked = self.question.target
        return conditioning(self.question.chain, self.q, asked.frame, asked.offset_m)

    @property
    def singularity(self) -> Singularity | None:
        """Look for the singular posture nearest to ``q``, some tens of ms; None if none is found.

        Where more than a position is wanted, one in which the link cannot turn counts as well.
        """
        if self.question is None:
            return None
        asked = self.question.target
        return nearest_singularity(
            self.question.chain,
            self.q,
            asked.frame,
            asked.offset_m,
            turning=not asked.only_position,
        )

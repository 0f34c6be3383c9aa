"""What a solver answers: the joints, and honestly how far they are from what was asked."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ikservo.kinematics.se3 import Vector

__all__ = ["BUILD", "Binding", "Result"]

BUILD = "the arm's build"
"""What holds an arm back where no limit does: its lengths, or how few ways its joints turn."""


@dataclass(frozen=True, slots=True)
class Binding:
    """A joint limit that keeps the tool from coming closer."""

    joint: str
    side: Literal["lower", "upper"]

    def __str__(self) -> str:
        return f"{self.joint} at its {self.side} limit"


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
    """

    q: Vector
    reached: bool
    position_error_m: float
    orientation_error_rad: float
    binding: tuple[Binding, ...]
    iterations: int
    nearest_m: Vector
    method: str
    trace: tuple[Vector, ...] = ()

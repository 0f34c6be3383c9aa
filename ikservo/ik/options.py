"""How a question is to be worked on: what counts as reached, how hard to try, what to lean to."""

from __future__ import annotations

from dataclasses import dataclass, field

from numpy.typing import ArrayLike

from ikservo.errors import BadValueError

__all__ = ["Options", "Posture", "Tolerance"]


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How close counts as reached."""

    position_m: float = 1e-5
    orientation_rad: float = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Posture:
    """A configuration to lean towards where the target leaves freedom (lecture L10).

    Attributes:
        q: The preferred joints (dof,), rad or m.
        weights: How strongly each leans (dof,); 0 leaves a joint alone.
    """

    q: ArrayLike
    weights: ArrayLike


@dataclass(frozen=True, slots=True, eq=False)
class Options:
    """What every method is given beside the question.

    Attributes:
        tolerance: How close counts as reached.
        restarts: How many starting points to try at most, the given one first.
        max_iterations: How many steps from one start; None for the method's own.
        posture: What to lean towards; methods without a null space ignore it.
        trace: Whether the result shall carry every iterate.
    """

    tolerance: Tolerance = field(default_factory=Tolerance)
    restarts: int = 40
    max_iterations: int | None = None
    posture: Posture | None = None
    trace: bool = False

    def __post_init__(self) -> None:
        if self.restarts < 1:
            raise BadValueError("restarts", self.restarts, "at least 1")
        if self.max_iterations is not None and self.max_iterations < 1:
            raise BadValueError("max_iterations", self.max_iterations, "at least 1")

"""How a question is to be worked on: what counts as reached, how hard to try, what to lean to."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

from numpy.typing import ArrayLike

from ikservo.errors import BadValueError

__all__ = ["Options", "Posture", "Tolerance"]

_FULL_POSE_DOF = 6


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
        restarts: How many starting points to try at most, the given one first; the lecture's
            methods know no other than that.
        max_iterations: How many steps from one start; None for the method's own.
        posture: What to lean towards; methods without a null space ignore it.
        trace: Whether the result shall carry every iterate.
        position_first: Whether the position is met exactly, and the orientation as well as what
            remains allows, rather than both weighed; None for arms with fewer than six joints.
        turn_weight_m_rad: How many metres of position error a radian is worth (``bounded``).
        track: One walk from the start, never past a limit, never to another branch (``bounded``).
    """

    tolerance: Tolerance = field(default_factory=Tolerance)
    restarts: int = 400
    max_iterations: int | None = None
    posture: Posture | None = None
    trace: bool = False
    position_first: bool | None = None
    turn_weight_m_rad: float = 0.2
    track: bool = False

    def __post_init__(self) -> None:
        if self.restarts < 1:
            raise BadValueError("restarts", self.restarts, "at least 1")
        if self.max_iterations is not None and self.max_iterations < 1:
            raise BadValueError("max_iterations", self.max_iterations, "at least 1")
        if not 0.0 < self.turn_weight_m_rad < math.inf:
            raise BadValueError("turn_weight_m_rad", self.turn_weight_m_rad, "above 0 and finite")

    def puts_position_first(self, dof: int) -> bool:
        """Return whether an arm with so many joints meets the position before all else."""
        return dof < _FULL_POSE_DOF if self.position_first is None else self.position_first

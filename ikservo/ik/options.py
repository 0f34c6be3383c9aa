"""How a question is to be worked on: what counts as reached, how hard to try, what to lean to."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError

__all__ = ["RESTARTS", "Options", "Posture", "Tolerance"]

RESTARTS = 400
"""How many starting points a search tries at most, if nobody says otherwise."""

_FULL_POSE_DOF = 6
# More starting points than this are a slip of the pen: their table would fill the memory.
_MOST = 1_000_000


@dataclass(frozen=True, slots=True)
class Tolerance:
    """How close counts as reached.

    Raises:
        BadValueError: No number above 0.
    """

    position_m: float = 1e-5
    orientation_rad: float = 1e-4

    def __post_init__(self) -> None:
        _check_above_0("A tolerance in metres", self.position_m)
        _check_above_0("A tolerance in radians", self.orientation_rad)


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
        nearest: Whether to look for the solution nearest the start where there are several
            (``auto``); without, the first that is found is the answer.
    """

    tolerance: Tolerance = field(default_factory=Tolerance)
    restarts: int = RESTARTS
    max_iterations: int | None = None
    posture: Posture | None = None
    trace: bool = False
    position_first: bool | None = None
    turn_weight_m_rad: float = 0.2
    track: bool = False
    nearest: bool = True

    def __post_init__(self) -> None:
        _check_count("restarts", self.restarts)
        if self.max_iterations is not None:
            _check_count("max_iterations", self.max_iterations)
        _check_above_0("turn_weight_m_rad", self.turn_weight_m_rad)
        if math.isinf(self.turn_weight_m_rad):
            raise BadValueError("turn_weight_m_rad", self.turn_weight_m_rad, "a finite number")
        for what, value in (
            ("track", self.track),
            ("trace", self.trace),
            ("nearest", self.nearest),
        ):
            _check_kind(what, value, bool)
        if self.position_first is not None:
            _check_kind("position_first", self.position_first, bool)
        _check_kind("The tolerance", self.tolerance, Tolerance)
        if self.posture is not None:
            _check_kind("The posture", self.posture, Posture)

    def puts_position_first(self, dof: int) -> bool:
        """Return whether an arm with so many joints meets the position before all else."""
        return dof < _FULL_POSE_DOF if self.position_first is None else self.position_first


def _check_above_0(what: str, value: float) -> None:
    array = np.asarray(value)
    if array.shape or array.dtype.kind not in "iuf" or not value > 0.0:
        raise BadValueError(what, repr(value), "a number above 0")


def _check_count(what: str, value: int) -> None:
    array = np.asarray(value)
    if array.shape or array.dtype.kind not in "iu" or not 1 <= value <= _MOST:
        raise BadValueError(what, repr(value), f"a whole number, at least 1, at most {_MOST}")


def _check_kind(what: str, value: object, kind: type) -> None:
    if not isinstance(value, kind):
        raise BadValueError(what, repr(value), f"a {kind.__name__}")

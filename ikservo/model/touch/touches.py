"""One touch: where the joints were while the tip was on a point."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["Touch", "joints_of", "unknown_points"]


@dataclass(frozen=True, slots=True, eq=False)
class Touch:
    """The tip on a point.

    Attributes:
        q: The joints (dof,) as the arm says at present, rad or m.
        point: The point's name.
        position_m: Where it is (3,), metres, in the frame that the arm's base shall have; None
            for a point that nobody has measured and that is touched several times.
    """

    q: Vector
    point: str
    position_m: Vector | None = None


def joints_of(touches: Sequence[Touch]) -> Matrix:
    """Return the joint vectors (n, dof)."""
    return np.array([touch.q for touch in touches])


def unknown_points(touches: Sequence[Touch]) -> tuple[str, ...]:
    """Return the names of the points that nobody has measured, each once."""
    return tuple(dict.fromkeys(touch.point for touch in touches if touch.position_m is None))

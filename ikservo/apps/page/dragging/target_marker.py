"""The target of a goal, as the page marks it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ikservo.arm import ToolOrientation
from ikservo.ik import ActiveLimit
from ikservo.kinematics.arrays import Vector


@dataclass(frozen=True, slots=True, eq=False)
class TargetMarker:
    """A target, and the point that the solver reached.

    Attributes:
        target_m: The target point (3,), metres, base frame.
        nearest_m: The point (3,) at the goal.
        reached: Whether the solver reached the target.
        binding: The active limits.
        frame: The link that was grabbed; None for the tip.
        stance: The wanted orientation of the tool; None if there is none, or a link was grabbed.
        turn_error_rad: The angle between the tool and its wanted orientation; 0 if none is wanted.
    """

    target_m: Vector
    nearest_m: Vector
    reached: bool
    binding: tuple[ActiveLimit, ...] = ()
    frame: str | None = None
    turn_error_rad: float = 0.0
    stance: ToolOrientation | None = None

    @property
    def gap_m(self) -> float:
        """Distance from the nearest point to the target."""
        return float(np.linalg.norm(self.target_m - self.nearest_m))

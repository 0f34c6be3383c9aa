"""The tool orientation that a motion asks for: pitch, roll, direction, or as it is now."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arm.arguments import parse_number
from ikservo.errors import BadValueError
from ikservo.ik import Posture, Target

__all__ = ["KEEP_BEST_EFFORT", "ToolOrientation", "check_orientation"]


@dataclass(frozen=True, slots=True, eq=False)
class ToolOrientation:
    """What is asked of the tool's orientation; nothing is, if all is left out.

    A tool of which nothing is asked keeps what the arm can: arms with six joints the whole
    orientation; arms with four or five its pitch, then its roll, in the plane that their first
    joint turns. What is asked must be met within half a degree.

    Attributes:
        pitch_rad: The angle of the tool axis above the horizontal: -π/2 is straight down.
        roll_rad: The turn about the tool axis, clockwise as seen from behind the tool; 0 is level.
        direction: Where the tool axis points (3,), base frame, any length.
        keep: Whether the orientation of the start is kept in the base frame, all of it.
        posture: Joints to lean towards instead, where the point leaves freedom (lecture L10).
        orientation: The whole orientation R_base_tip (3, 3). An arm with fewer than six joints
            has it at few points only.

    Raises:
        BadValueError: They contradict each other, or are no finite numbers.
    """

    pitch_rad: float | None = None
    roll_rad: float | None = None
    direction: ArrayLike | None = None
    keep: bool = False
    posture: Posture | None = None
    orientation: ArrayLike | None = None

    def __post_init__(self) -> None:
        for name, angle, most in (
            ("pitch", self.pitch_rad, math.pi / 2),
            ("roll", self.roll_rad, math.tau),
        ):
            if angle is not None and not abs(parse_number(f"The {name}", angle)) <= most + 1e-9:
                raise BadValueError(
                    f"The {name}",
                    f"{math.degrees(angle):g}°",
                    f"at most ±{math.degrees(most):.0f}°",
                )
        Target((0.0, 0.0, 0.0), direction=self.direction)
        Target((0.0, 0.0, 0.0), orientation=self.orientation)
        if self.orientation is not None and replace(self, orientation=None).is_constrained:
            raise BadValueError(
                "The tool orientation", "given twice", "an orientation, or parts of it"
            )
        if self.keep and self.constrains_more_than_keep:
            raise BadValueError("The tool orientation", "given twice", "keep, or an orientation")
        if self.direction is not None and self.pitch_rad is not None:
            raise BadValueError("The tool orientation", "given twice", "a direction, or a pitch")
        if self.posture is not None and self.is_constrained:
            raise BadValueError(
                "The tool orientation", "given twice", "a preferred posture, or an orientation"
            )

    @property
    def constrains_more_than_keep(self) -> bool:
        """Return whether anything but to keep is asked."""
        parts = (self.pitch_rad, self.roll_rad, self.direction, self.orientation)
        return any(part is not None for part in parts)

    @property
    def is_constrained(self) -> bool:
        """Return whether anything is asked."""
        return self.keep or self.constrains_more_than_keep

    def __str__(self) -> str:
        """Return it in words."""
        words = [
            f"pitch {math.degrees(self.pitch_rad):.1f}°" if self.pitch_rad is not None else "",
            f"roll {math.degrees(self.roll_rad):.1f}°" if self.roll_rad is not None else "",
            "direction " + ",".join(f"{x:g}" for x in np.ravel(self.direction))
            if self.direction is not None
            else "",
            "the present orientation" if self.keep else "",
            "the given orientation" if self.orientation is not None else "",
        ]
        return " and ".join(word for word in words if word)


KEEP_BEST_EFFORT = ToolOrientation()
"""Nothing asked."""


def check_orientation(stance: object, orientation: ArrayLike | None = None) -> ToolOrientation:
    """Return how the tool shall stand, with an orientation (3, 3) that was given besides.

    Raises:
        BadValueError: It is no ``ToolOrientation``, or asks for another orientation.
    """
    if not isinstance(stance, ToolOrientation):
        raise BadValueError(
            "The stance", repr(stance), "a ToolOrientation, such as ToolOrientation(pitch_rad=0.0)"
        )
    return stance if orientation is None else replace(stance, orientation=orientation)

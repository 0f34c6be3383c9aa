"""How a person wants the tool to stand at a point: steep, rolled, pointing somewhere, or as now."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.arm.given import number
from ikservo.errors import BadValueError
from ikservo.ik import Target

__all__ = ["AS_IT_CAN", "Stance", "stance_of"]


@dataclass(frozen=True, slots=True, eq=False)
class Stance:
    """What is asked of the tool's orientation; nothing is, if all is left out.

    A tool of which nothing is asked keeps what the arm can: arms with six joints the whole
    orientation; arms with four or five its pitch, then its roll, in the plane that their first
    joint turns. What is asked must be met within half a degree.

    Attributes:
        pitch_rad: The angle of the tool axis above the horizontal: -π/2 is straight down.
        roll_rad: The turn about the tool axis, clockwise as seen from behind the tool; 0 is level.
        direction: Where the tool axis points (3,), base frame, any length.
        keep: Whether the orientation of the start is kept in the base frame, all of it.

    Raises:
        BadValueError: They contradict each other, or are no finite numbers.
    """

    pitch_rad: float | None = None
    roll_rad: float | None = None
    direction: ArrayLike | None = None
    keep: bool = False

    def __post_init__(self) -> None:
        for name, angle, most in (
            ("pitch", self.pitch_rad, math.pi / 2),
            ("roll", self.roll_rad, math.tau),
        ):
            if angle is not None and not abs(number(f"The {name}", angle)) <= most + 1e-9:
                raise BadValueError(
                    f"The {name}", f"{angle} rad", f"at most ±{math.degrees(most):.0f}°"
                )
        Target((0.0, 0.0, 0.0), direction=self.direction)
        if self.keep and self.asked_besides:
            raise BadValueError("The tool's stance", "asked twice", "keep, or how it shall stand")
        if self.direction is not None and self.pitch_rad is not None:
            raise BadValueError("The tool's stance", "asked twice", "a direction, or a pitch")

    @property
    def asked_besides(self) -> bool:
        """Return whether anything but to keep is asked."""
        return not (self.pitch_rad is None and self.roll_rad is None and self.direction is None)

    @property
    def asked(self) -> bool:
        """Return whether anything is asked."""
        return self.keep or self.asked_besides

    def __str__(self) -> str:
        """Return it in words."""
        words = [
            f"pitch {math.degrees(self.pitch_rad):.1f}°" if self.pitch_rad is not None else "",
            f"roll {math.degrees(self.roll_rad):.1f}°" if self.roll_rad is not None else "",
            "direction " + ",".join(f"{x:g}" for x in np.ravel(self.direction))
            if self.direction is not None
            else "",
            "the orientation it has now" if self.keep else "",
        ]
        return " and ".join(word for word in words if word)


AS_IT_CAN = Stance()
"""Nothing asked."""


def stance_of(stance: object) -> Stance:
    """Return how the tool shall stand.

    Raises:
        BadValueError: It is no ``Stance``.
    """
    if not isinstance(stance, Stance):
        raise BadValueError("The stance", repr(stance), "a Stance, such as Stance(pitch_rad=0.0)")
    return stance

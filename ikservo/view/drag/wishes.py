"""What a person wants of the arm, as values."""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.ik import Target

__all__ = ["Hold", "Pull", "Turn", "Wish"]


@dataclass(frozen=True, slots=True, eq=False)
class Pull:
    """A point of the arm shall go there.

    Attributes:
        target: The point, fixed to the tip or to the link that was grabbed, and where to.
        jump: Whether the arm may fold differently to get there: after a click, not in a drag.
    """

    target: Target
    jump: bool = False


@dataclass(frozen=True, slots=True)
class Turn:
    """One joint shall go to a position inside its limits, rad or m; the others stay."""

    joint: str
    position: float


@dataclass(frozen=True, slots=True)
class Hold:
    """Stay where you are."""


Wish = Pull | Turn | Hold

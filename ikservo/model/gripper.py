"""What an arm file knows of a gripper: which way it closes, and how far apart its jaws are."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

__all__ = ["Gripper"]


@dataclass(frozen=True, slots=True)
class Gripper:
    """The joint that moves the jaws.

    Attributes:
        joint: Its name.
        closed: Where the jaws meet, rad or m; the end of its range on that side.
        open: Where they are furthest apart.
        widths: Pairs of a position [rad or m] and the distance of the jaws there [m], by position;
            straight lines between. Empty where nobody has measured it.
    """

    joint: str
    closed: float
    open: float
    widths: tuple[tuple[float, float], ...] = ()

    def width_m(self, position: float) -> float | None:
        """Return how far the jaws are apart at a position, metres; None where nobody knows."""
        if not self.widths:
            return None
        positions, widths_m = zip(*self.widths, strict=True)
        return float(np.interp(position, positions, widths_m))

    def range_m(self) -> tuple[float, float] | None:
        """Return the smallest and the greatest distance of the jaws, where it is known."""
        closed_m, open_m = self.width_m(self.closed), self.width_m(self.open)
        if closed_m is None or open_m is None:
            return None
        return min(closed_m, open_m), max(closed_m, open_m)

    def position(self, width_m: float) -> float:
        """Return where the jaws are that far apart; the widths must be known."""
        rows: Sequence[tuple[float, float]] = sorted(self.widths, key=lambda row: row[1])
        positions, widths_m = zip(*rows, strict=True)
        return float(np.interp(width_m, widths_m, positions))

"""Which of the things under the pointer a press means: the first, or one behind it (lecture L17).

Where links, objects and the free plane lie behind each other, a click without a motion, or a key,
goes on to the next; once the pointer is elsewhere, or something else is under it, it is the first
again. None stands for none of them: the tip is to come to the pointer.
"""

from __future__ import annotations

import numpy as np

from ikservo.kinematics.se3 import Vector
from ikservo.view.pick.under import Found, Sight, Under

__all__ = ["STILL_PX", "Choosing"]

STILL_PX = 4.0
"""A pointer that moves less stays where it is."""

Names = tuple[tuple[str, str] | None, ...]


class Choosing:
    """Remembers which of the things under a resting pointer is chosen.

    Args:
        under: Finds them.
    """

    def __init__(self, under: Under) -> None:
        self._under = under
        self._at: Vector | None = None
        self._names: Names = ()
        self._index = 0

    def options(self, at: Vector, sight: Sight) -> tuple[Found | None, ...]:
        """Return what a press at a pixel (2,) may mean: links, objects, None, what is fixed."""
        found = self._under.all(at, sight)
        fixed = tuple(each for each in found if each.kind == "fixed")
        return (*found[: len(found) - len(fixed)], None, *fixed)

    def index(self, at: Vector, options: tuple[Found | None, ...]) -> int:
        """Return which of the options at a pixel (2,) is chosen."""
        return self._index % len(options) if self._stays(at, _names(options)) else 0

    def chosen(self, at: Vector, sight: Sight) -> Found | None:
        """Return what a press at a pixel (2,) means."""
        options = self.options(at, sight)
        return options[self.index(at, options)]

    def go_on(self, at: Vector, sight: Sight, step: int = 1) -> None:
        """Choose the next, or with -1 the one before, at a pixel (2,)."""
        options = self.options(at, sight)
        self._index = (self.index(at, options) + step) % len(options)
        self._at, self._names = at, _names(options)

    def forget(self) -> None:
        """Choose the first again."""
        self._at = None

    def _stays(self, at: Vector, names: Names) -> bool:
        if self._at is None or names != self._names:
            return False
        return float(np.hypot(*(at - self._at))) < STILL_PX


def _names(options: tuple[Found | None, ...]) -> Names:
    return tuple(None if found is None else (found.hit.link, found.kind) for found in options)

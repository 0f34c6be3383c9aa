"""Earlier targets of a page, for undo and redo."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass

from ikservo.apps.page.dragging.target_marker import TargetMarker
from ikservo.errors import InputError
from ikservo.kinematics.arrays import Vector

_MAX_GOALS = 100
_ONE_GESTURE_S = 0.7  # messages of one kind within this time are one gesture


@dataclass(frozen=True, slots=True, eq=False)
class PastGoal:
    """A previous target: goal of all joints (n,), rad or m, and marker; either may be None."""

    goal: Vector | None
    marker: TargetMarker | None


class GoalHistory:
    """Previous targets, and targets that were undone."""

    def __init__(self) -> None:
        self._past: deque[PastGoal] = deque(maxlen=_MAX_GOALS)
        self._undone: list[PastGoal] = []
        self._last_kind, self._last_s = "", -1e9

    @property
    def can_undo(self) -> bool:
        """Whether there is a previous target."""
        return bool(self._past)

    @property
    def can_redo(self) -> bool:
        """Whether a target was undone."""
        return bool(self._undone)

    def record(self, before: PastGoal, kind: str, now_s: float) -> None:
        """Record the target before it is changed.

        A ``kind`` of input that is repeated within 0.7 s belongs to the same gesture; an input of
        an empty kind is always a gesture of its own.
        """
        continued = bool(kind) and kind == self._last_kind
        is_same_gesture = continued and now_s - self._last_s < _ONE_GESTURE_S
        self._last_kind, self._last_s = kind, now_s
        if not is_same_gesture:
            self._past.append(before)
            self._undone.clear()

    def clear(self) -> None:
        """Forget all targets."""
        self._past.clear()
        self._undone.clear()
        self._last_kind = ""

    def undo(self, present: PastGoal) -> PastGoal:
        """Return the target before the present one.

        Raises:
            InputError: There is no previous target.
        """
        if not self._past:
            raise InputError("There is nothing to undo.", "The target stays.")
        self._undone.append(present)
        self._last_kind = ""
        return self._past.pop()

    def redo(self, present: PastGoal) -> PastGoal:
        """Return the target that was undone last.

        Raises:
            InputError: No target was undone.
        """
        if not self._undone:
            raise InputError("There is nothing to redo.", "The target stays.")
        self._past.append(present)
        self._last_kind = ""
        return self._undone.pop()

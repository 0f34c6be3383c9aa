"""Whether the guard refuses a goal: in the preview by the same check as while the arm follows."""

from __future__ import annotations

from ikservo.arm import Arm, check_followed_goal
from ikservo.errors import CollisionError, RefusedError
from ikservo.kinematics.arrays import Vector
from ikservo.view.snapshot import GoalRefusal

__all__ = ["PreviewGuard", "refusal_of"]

# A check takes 1 to 12 ms; between two the page still has to be drawn.
_PERIOD_S = 0.04


def refusal_of(goal: Vector, error: RefusedError) -> GoalRefusal:
    """Return the refusal of a goal (n,), in words for a page."""
    if not isinstance(error, CollisionError):
        return GoalRefusal(goal, error.message)
    return GoalRefusal(goal, f"Refused: {error.cause}.", error.pair)


class PreviewGuard:
    """Checks the goals of a preview, each once, and not more often than time allows.

    Args:
        arm: Its guard checks; moves nothing.

    Attributes:
        refusal: Why the last goal was refused; None if it was not.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self._checked: Vector | None = None
        self._checked_s = -1e9
        self.refusal: GoalRefusal | None = None

    def update(self, goal: Vector | None, start: Vector, speed: str, now_s: float) -> None:
        """Check a goal (n,) from where the joints are (n,), unless that was done or is too soon.

        Args:
            goal: The goal, the same array while it is the same; None for none.
            start: Where the motion would start.
            speed: Its speed class.
            now_s: The time.
        """
        if goal is None:
            self.refusal = self._checked = None
        elif goal is not self._checked and now_s - self._checked_s >= _PERIOD_S:
            self._checked, self._checked_s = goal, now_s
            self.refusal = self._check(goal, start, speed)

    def _check(self, goal: Vector, start: Vector, speed: str) -> GoalRefusal | None:
        try:
            check_followed_goal(self._arm.context, start, goal, speed)
        except RefusedError as error:
            return refusal_of(goal, error)
        return None

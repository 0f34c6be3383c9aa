"""The gripper under a thumb: it closes or opens while that presses, and never presses hard."""

from __future__ import annotations

from ikservo.arm import Arm
from ikservo.kinematics.se3 import Vector

__all__ = ["Jaws", "jaws_of"]

_WHOLE_S = 1.5  # from closed to open
_AHEAD = 0.06  # of the range: so far goals lead jaws that something keeps apart
_LONGEST_S = 0.1  # between two messages; after more the thumb was lifted


class Jaws:
    """Remembers since when they are being moved.

    Args:
        column: The gripper's entry among all joints.
        closed: Where the jaws meet, rad or m.
        opened: Where they are furthest apart.
    """

    def __init__(self, column: int, closed: float, opened: float) -> None:
        self.column = column
        self._closed, self._opened = closed, opened
        self._last_s = -1e9

    def goal(self, grip: float, goal: float, measured: Vector, now_s: float) -> float | None:
        """Return where the joint shall go, rad or m; None while nobody presses.

        Args:
            grip: 1 closes, -1 opens, less does it more slowly.
            goal: Where it was to go so far.
            measured: Where all joints are (n,).
            now_s: The time.
        """
        elapsed_s, self._last_s = min(now_s - self._last_s, _LONGEST_S), now_s
        if not grip:
            return None
        whole = self._closed - self._opened
        at, ahead = float(measured[self.column]), abs(whole) * _AHEAD
        wanted = goal + grip * whole * elapsed_s / _WHOLE_S
        wanted = min(max(wanted, at - ahead), at + ahead)
        low, high = sorted((self._closed, self._opened))
        return min(max(wanted, low), high)


def jaws_of(arm: Arm) -> Jaws | None:
    """Return the gripper of an arm, inside its calibrated limits; None where it has none."""
    gripper = arm.model.gripper
    if gripper is None:
        return None
    column = [joint.name for joint in arm.model.joints].index(gripper.joint)
    lower, upper = arm.workings.limits()
    low, high = float(lower[column]), float(upper[column])
    ends = (min(max(end, low), high) for end in (gripper.closed, gripper.open))
    return Jaws(column, *ends)

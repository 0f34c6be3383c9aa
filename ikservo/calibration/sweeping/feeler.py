"""Whether a joint that is driven gently has come to a stop: by place, load and time together.

One of the three alone deceives. A joint stands still because it has not begun to move; it works
hard because it lifts something; it is late because the bus was busy. Only where it stands for a
while, well behind its goal, and its servo presses as hard as it may, something solid is there.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

__all__ = ["Feeler", "Touch"]

_STANDS_S = 0.25
_STANDS_RAD = 0.004  # less than three ticks of 4096
_BEHIND_RAD = 0.045  # a servo that presses with a third of its torque is about so far behind
_PRESSES = 0.4  # of what it may, by its own word
_SLACK_S = 1.5  # standing for so long without pressing is no stop


class Touch(Enum):
    """What a joint does that is driven towards its stop."""

    MOVING = "it moves"
    STOP = "it stands against something"
    SLACK = "it stands although nothing holds it"


@dataclass(frozen=True, slots=True)
class Feeler:
    """One joint on its way to a stop; angles are of the servo's horn.

    Attributes:
        most_percent: How hard its servo may press.
        touch: What the joint does.
        since_s: When it last moved; None before the first look.
        at_rad: Where it was then.
    """

    most_percent: float
    touch: Touch = Touch.MOVING
    since_s: float | None = None
    at_rad: float = 0.0

    def suspects(self, at_s: float, at_rad: float, goal_rad: float) -> bool:
        """Return whether the load decides now: it stands behind its goal for long enough."""
        seen = self.moved(at_s, at_rad)
        standing_s = at_s - (at_s if seen.since_s is None else seen.since_s)
        return standing_s >= _STANDS_S and abs(goal_rad - at_rad) >= _BEHIND_RAD

    def moved(self, at_s: float, at_rad: float) -> Feeler:
        """Return it with one more look at where the joint is."""
        if self.since_s is None or abs(at_rad - self.at_rad) > _STANDS_RAD:
            return replace(self, since_s=at_s, at_rad=at_rad, touch=Touch.MOVING)
        return self

    def felt(self, at_s: float, at_rad: float, goal_rad: float, load_percent: float) -> Feeler:
        """Return what a look says.

        Args:
            at_s: When.
            at_rad: Where the horn is.
            goal_rad: Where it is told to go.
            load_percent: How hard its servo says that it presses; the sign is not looked at.
        """
        seen = self.moved(at_s, at_rad)
        if not self.suspects(at_s, at_rad, goal_rad):
            return seen
        if abs(load_percent) >= _PRESSES * self.most_percent:
            return replace(seen, touch=Touch.STOP)
        standing_s = at_s - (at_s if seen.since_s is None else seen.since_s)
        return replace(seen, touch=Touch.SLACK) if standing_s >= _SLACK_S else seen

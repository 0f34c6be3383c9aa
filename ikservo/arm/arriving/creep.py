"""One joint's goal that creeps on until the joint itself is where it is wanted."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

from ikservo.calibration import source_words
from ikservo.guard import Fence

__all__ = ["Creep", "Saturation", "SaturationReason"]

# The goal moves by this share of what is missing each second, and no slower than the second
# number [rad/s at the horn]: what sticks must come loose in good time.
_SHARE_PER_S = 4.0
_SLOWEST_RAD_S = 8 * math.tau / 4096
# Near its place a joint that has just moved is waited for: one that broke loose still slides.
_NEAR_TICKS = 3
_WAIT_S = 0.04
# More than sensors flicker.
_FLICKER_TICKS = 1


class Saturation(Enum):
    """What keeps the goal of a joint from going on."""

    LOAD = auto()
    """The goal leads the joint by as much as the guard allows of a joint at rest."""
    LIMIT = auto()
    """The goal is at a limit of the joint."""


@dataclass(frozen=True, slots=True)
class SaturationReason:
    """Why the goal of a joint goes no further.

    Attributes:
        kind: What keeps it.
        text: The same for the user, with the limit that binds and where that comes from.
    """

    kind: Saturation
    text: str


class Creep:
    """Integrates what a joint is short of into its goal.

    It ends at the tick that is wanted. A joint without load sticks and then leaps by a tick or
    two; when it has gone across, one tick beside is as near as it gets, and it is not turned
    round for that: on the way back it would lose its play and leap again.

    Args:
        fence: What its servo may be told.
        goal: Where the goal is, ticks.
        wanted: Where the joint shall be, ticks; None where it only has to stand still.
        acceleration: How fast the goal's speed may change, ticks/s².

    Attributes:
        goal: Where the goal is, ticks with fraction.
        at: Where the joint was last seen, ticks.
        still_since_s: Since when the joint stands.
    """

    def __init__(self, fence: Fence, goal: int, wanted: int | None, acceleration: float) -> None:
        self.fence, self.goal, self.wanted = fence, float(goal), wanted
        low, high = fence.ticks
        self._low, self._high = min(low, goal), max(high, goal)
        self._acceleration = acceleration
        self._slowest = _SLOWEST_RAD_S / fence.joint_map.horn_rad_per_tick
        self._lead = fence.lead_ticks(0.0)
        self.at = self._before = self._anchor = goal if wanted is None else wanted
        self._moved_s, self.still_since_s = -math.inf, 0.0
        self._side, self._crossed = 0, False
        self._rate = 0.0

    @property
    def short(self) -> int:
        """Return how many ticks the joint is short of where it is wanted, signed."""
        return 0 if self.wanted is None else self.wanted - self.at

    @property
    def there(self) -> bool:
        """Return whether the joint is as near as it gets."""
        return self.short == 0 or (self._crossed and abs(self.short) <= 1)

    @property
    def saturation_reason(self) -> SaturationReason | None:
        """What keeps the goal from going on; None where nothing does."""
        if self._leads_enough():
            return SaturationReason(Saturation.LOAD, "load too high (correction limit reached)")
        end = self._high if self._side > 0 else self._low
        if self.there or self._side * (end - self.goal) > 0:
            return None
        limits = self.fence.limits
        upper = self.fence.joint_map.sign * self._side > 0
        limit = limits.upper if upper else limits.lower
        value, source = self.fence.joint_map.say(limit.value), source_words(limit.source)
        return SaturationReason(Saturation.LIMIT, f"at its limit {value} ({source})")

    def goal_at(self, after_s: float) -> float:
        """Return the goal's tick a time after it was last looked at."""
        return min(max(self.goal + self._rate * after_s, self._low), self._high)

    def see(self, tick: int, time_s: float, elapsed_s: float) -> None:
        """Take where the joint is, and choose how fast its goal goes on."""
        self.goal = self.goal_at(elapsed_s)
        self._note(tick, time_s)
        wish = self._wish(time_s)
        most = self._acceleration * elapsed_s
        self._rate = min(max(wish, self._rate - most), self._rate + most) if wish else 0.0

    def _note(self, tick: int, time_s: float) -> None:
        if tick != self.at:
            if tick != self._before:  # back at the tick before it only flickers
                self._moved_s = time_s
            self._before, self.at = self.at, tick
        if abs(tick - self._anchor) > _FLICKER_TICKS:
            self._anchor, self.still_since_s = tick, time_s
        side = (self.short > 0) - (self.short < 0)
        self._crossed = self._crossed or side * self._side < 0
        self._side = side or self._side

    def _wish(self, time_s: float) -> float:
        """Return how fast the goal should go on, ticks/s, signed."""
        if self.there or self._leads_enough():
            return 0.0
        if abs(self.short) <= _NEAR_TICKS and time_s - self._moved_s < _WAIT_S:
            return 0.0
        return math.copysign(max(_SHARE_PER_S * abs(self.short), self._slowest), self.short)

    def _leads_enough(self) -> bool:
        return not self.there and self._side * (self.goal - self.at) >= self._lead

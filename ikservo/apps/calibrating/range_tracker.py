"""Range tracking of one joint: unwrapped ticks, standstill and end-stop detection.

No single sign of a stop is reliable: a joint may stand still because it has not started to move,
its load may be high because it lifts something, and it may lag because the bus is busy. A stop is
found only if the joint rests for a while, far behind its goal, with its servo near maximum load.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

from ikservo.calibration.joint_map import unwrap
from ikservo.control.stillness import StillnessDetector

SWEEP_UNCHANGED_S = 1.0
"""Time without a new extreme after which a sweep with complete ranges ends [s]."""

NARROW_SWEEP_UNCHANGED_S = 4.0
"""Time without a new extreme after which a sweep with narrow ranges ends [s]."""

# Between two readings a hand moves a joint far less than a quarter revolution. After a longer
# interval the count is ambiguous if the joint could have moved the other way round meanwhile.
_MAX_STEP = 1024
_MAX_TURNS_PER_S = 1.6  # fastest motion by hand: 10 rad/s


@dataclass(frozen=True, slots=True)
class RangeTracker:
    """The position and range of a servo, in unwrapped encoder ticks (without homing offset).

    Attributes:
        ticks_per_turn: Ticks of a revolution, or 0 for a sensor that does not wrap around.
        tick: The present tick.
        low: The lowest tick so far.
        high: The highest tick so far.
        at_s: Time of the last reading.
        lost: Whether the joint was moved too fast to be tracked; it must then be measured again.
    """

    ticks_per_turn: int
    tick: int
    low: int
    high: int
    at_s: float
    lost: bool = False

    @classmethod
    def start_at(cls, ticks_per_turn: int, tick: int, at_s: float) -> RangeTracker:
        """Return a tracker that starts at a tick."""
        return cls(ticks_per_turn, tick, tick, tick, at_s)

    @property
    def width(self) -> int:
        """The number of ticks between the recorded ends."""
        return self.high - self.low

    def update(self, reading: int, at_s: float) -> RangeTracker:
        """Add a reading."""
        if not self.ticks_per_turn:
            return self.update_unwrapped(reading, at_s)
        tick = unwrap(self.tick, reading, self.ticks_per_turn)
        jumped = abs(tick - self.tick) > _MAX_STEP
        other_direction = self.ticks_per_turn - abs(tick - self.tick)
        ambiguous = other_direction <= _MAX_TURNS_PER_S * self.ticks_per_turn * (at_s - self.at_s)
        lost = self.lost or jumped or ambiguous
        return replace(self.update_unwrapped(tick, at_s), lost=lost)

    def update_unwrapped(self, tick: int, at_s: float) -> RangeTracker:
        """Add a reading that is already unwrapped."""
        low, high = min(self.low, tick), max(self.high, tick)
        return replace(self, tick=tick, low=low, high=high, at_s=at_s)

    def restarted(self) -> RangeTracker:
        """Return a tracker whose range contains only the present tick; unwrapping continues."""
        return replace(self, low=self.tick, high=self.tick, lost=False)

    def with_range_of(self, earlier: RangeTracker) -> RangeTracker:
        """Return the tracker at its present tick with the range of an earlier tracker."""
        lost = self.lost or earlier.lost
        return replace(self, low=earlier.low, high=earlier.high, lost=lost)


_BLOCKED_RAD = 0.004  # less than three of 4096 ticks per revolution
_BLOCKED = StillnessDetector(0.25, _BLOCKED_RAD, least_readings=2)
_CONTACT_LOAD_PERCENT = 0.4  # fraction of the maximum load that the servo reports
# A joint that rests for longer than this without load is not at a stop.
_IDLE = StillnessDetector(1.5, _BLOCKED_RAD, least_readings=2)


class ContactState(Enum):
    """State of a joint that is driven towards its stop."""

    MOVING = "it moves"
    STOP = "it presses against something"
    NO_CONTACT = "it does not move although nothing holds it"


@dataclass(frozen=True, slots=True)
class EndStopDetector:
    """Detector of one joint's stop; all angles are angles of the servo's horn.

    Static friction and gravity may hold a joint until its servo pushes with its full allowed
    torque. So a joint at rest is at a stop only if its lag is large enough for that torque.

    Attributes:
        max_load_percent: The load limit of the servo.
        min_lag_rad: The smallest lag behind the goal at which the joint counts as blocked.
        contact: The state of the joint.
        blocked: Whether the joint has stood still long enough to be at a stop.
        idle: Whether the joint has stood still so long that a small load shows that nothing blocks
            it.
    """

    max_load_percent: float
    min_lag_rad: float
    contact: ContactState = ContactState.MOVING
    blocked: StillnessDetector = _BLOCKED
    idle: StillnessDetector = _IDLE

    def may_be_blocked(self, at_s: float, at_rad: float, goal_rad: float) -> bool:
        """Return whether the load must be checked because the joint rests behind its goal."""
        stands = self.update(at_s, at_rad).blocked.is_at_rest()
        return stands and abs(goal_rad - at_rad) >= self.min_lag_rad

    def update(self, at_s: float, at_rad: float) -> EndStopDetector:
        """Add a position sample."""
        blocked = self.blocked.add_joints(at_s, [at_rad])
        idle = self.idle.add_joints(at_s, [at_rad])
        contact = ContactState.MOVING if blocked.has_moved() else self.contact
        return replace(self, blocked=blocked, idle=idle, contact=contact)

    def update_with_load(
        self, at_s: float, at_rad: float, goal_rad: float, load_percent: float
    ) -> EndStopDetector:
        """Add a sample of the horn: its position, its goal, and its load, whose sign is ignored."""
        updated = self.update(at_s, at_rad)
        if not self.may_be_blocked(at_s, at_rad, goal_rad):
            return updated
        if abs(load_percent) >= _CONTACT_LOAD_PERCENT * self.max_load_percent:
            return replace(updated, contact=ContactState.STOP)
        is_idle = updated.idle.is_at_rest()
        return replace(updated, contact=ContactState.NO_CONTACT) if is_idle else updated

"""Range tracking of one joint: unwrapped ticks, standstill and end-stop detection.

One of the three alone is not reliable: a joint stands still because it has not started to move;
its load is high because it lifts something; it lags because the bus was busy. Only if it is at
rest for a while, well behind its goal, with its servo near its maximum load, there is a stop.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum

from ikservo.calibration.homing import TickRange
from ikservo.calibration.joint_limits import Limits
from ikservo.calibration.joint_map import JointMap, unwrap

__all__ = [
    "ContactState",
    "EndStopDetector",
    "JointUnderCalibration",
    "RangeTracker",
    "StillnessDetector",
]


# Between two readings a hand moves a joint far less than a quarter revolution. After a longer
# interval the count is ambiguous if the joint could have moved the other way round meanwhile.
_MAX_STEP = 1024
_MAX_TURNS_PER_S = 1.6  # of a hand: 10 rad/s


@dataclass(frozen=True, slots=True)
class RangeTracker:
    """Position and range of a servo, in unwrapped bare ticks.

    Attributes:
        ticks_per_turn: Ticks of a revolution, or 0 for a sensor that does not wrap around.
        tick: The present tick.
        low: The lowest tick so far.
        high: The highest.
        at_s: Time of the last reading.
        lost: Whether it was moved too fast to be tracked; it must be measured again.
    """

    ticks_per_turn: int
    tick: int
    low: int
    high: int
    at_s: float
    lost: bool = False

    @classmethod
    def start_at(cls, ticks_per_turn: int, tick: int, at_s: float) -> RangeTracker:
        """Return a track that begins at a tick."""
        return cls(ticks_per_turn, tick, tick, tick, at_s)

    @property
    def width(self) -> int:
        """The ticks between the recorded ends."""
        return self.high - self.low

    def update(self, reading: int, at_s: float) -> RangeTracker:
        """Add one more reading to the track."""
        tick = unwrap(self.tick, reading, self.ticks_per_turn) if self.ticks_per_turn else reading
        jumped = self.ticks_per_turn and abs(tick - self.tick) > _MAX_STEP
        other_direction = self.ticks_per_turn - abs(tick - self.tick)
        ambiguous = other_direction <= _MAX_TURNS_PER_S * self.ticks_per_turn * (at_s - self.at_s)
        return replace(
            self,
            tick=tick,
            low=min(self.low, tick),
            high=max(self.high, tick),
            at_s=at_s,
            lost=self.lost or bool(jumped or (self.ticks_per_turn and ambiguous)),
        )

    def update_unwrapped(self, tick: int, at_s: float) -> RangeTracker:
        """Add one more reading that is already unwrapped to the track."""
        low, high = min(self.low, tick), max(self.high, tick)
        return replace(self, tick=tick, low=low, high=high, at_s=at_s)

    def restarted(self) -> RangeTracker:
        """Return a track whose range is only the present tick; unwrapping continues."""
        return replace(self, low=self.tick, high=self.tick, lost=False)

    def with_range_of(self, earlier: RangeTracker) -> RangeTracker:
        """Return the track at its present tick with the range of an earlier one."""
        lost = self.lost or earlier.lost
        return replace(self, low=earlier.low, high=earlier.high, lost=lost)


_WINDOW_S = 0.5
_NOISE_TICKS = 4


@dataclass(frozen=True, slots=True)
class StillnessDetector:
    """The positions of the last while, by servo or joint: unwrapped ticks, rad or m.

    Attributes:
        window_s: For how long nothing may move.
        tolerance: By how much positions may vary at rest.
        readings: Times and positions within the window, and the last ones before it.
    """

    window_s: float = _WINDOW_S
    tolerance: float = _NOISE_TICKS
    readings: tuple[tuple[float, Mapping[int, float]], ...] = ()

    def add_reading(self, at_s: float, positions: Mapping[int, float]) -> StillnessDetector:
        """Add one more reading, without those that are too old."""
        start_s = at_s - self.window_s
        recent = [row for row in self.readings if row[0] > start_s]
        before = [row for row in self.readings if row[0] <= start_s][-1:]
        return replace(self, readings=(*before, *recent, (at_s, positions)))

    def restarted(self) -> StillnessDetector:
        """Return it without readings."""
        return replace(self, readings=())

    def is_at_rest(self) -> bool:
        """Check whether nothing has moved within the window."""
        if len(self.readings) < 3 or self.readings[-1][0] - self.readings[0][0] < self.window_s:
            return False
        return all(max(column) - min(column) <= self.tolerance for column in self._columns())

    def mean_ticks(self) -> dict[int, float]:
        """Compute the mean position of each servo over the window."""
        means = (sum(column) / len(column) for column in self._columns())
        return dict(zip(self.readings[-1][1], means, strict=True))

    def _columns(self) -> list[list[float]]:
        return [[positions[i] for _, positions in self.readings] for i in self.readings[-1][1]]


_MIN_MOTION_DEG = 15.0


@dataclass(frozen=True, slots=True)
class JointUnderCalibration:
    """What is known of a joint before its calibration.

    Attributes:
        joint_map: Scale and sign of the arm file; its zero tick is not used.
        ticks_per_turn: Ticks after which the servo's count wraps around; 0 if it never does.
        expected: The arm file's range.
        pose: Its position in the reference pose, rad or m.
        shadow_ids: Servos that drive the joint together with the first.
        known: Its travel in bare ticks if that was measured before; it is then not recorded.
    """

    joint_map: JointMap
    ticks_per_turn: int
    expected: Limits
    pose: float
    shadow_ids: tuple[int, ...] = ()
    known: TickRange | None = None

    @property
    def name(self) -> str:
        """The joint's name."""
        return self.joint_map.joint

    @property
    def servo_id(self) -> int:
        """The id of the joint's first servo."""
        return self.joint_map.servo_id

    @property
    def free_direction(self) -> int:
        """The direction, +1 or -1, with the larger range from the reference pose."""
        above = self.expected.upper.value - self.pose
        return 1 if above >= self.pose - self.expected.lower.value else -1

    @property
    def expected_ticks(self) -> float:
        """How many ticks wide the arm file's range is."""
        low, high = self.expected.lower.value, self.expected.upper.value
        return abs(self.joint_map.ticks_from_zero(high) - self.joint_map.ticks_from_zero(low))

    @property
    def min_motion_ticks(self) -> float:
        """How far the joint must move to show its direction."""
        return min(
            _MIN_MOTION_DEG / 360.0 * (self.ticks_per_turn or 1229), 0.25 * self.expected_ticks
        )

    def zero_tick(self, sign: int, anchor_tick: float) -> float:
        """Compute the tick at position zero, given the tick in the reference pose."""
        return anchor_tick - self.joint_map.with_mounting(sign, 0.0).ticks_from_zero(self.pose)

    def with_mounting(self, sign: int, anchor_tick: float) -> JointMap:
        """Return the joint's map, given the servo's sign and its tick in the reference pose."""
        return self.joint_map.with_mounting(sign, self.zero_tick(sign, anchor_tick))


_BLOCKED_S = 0.25
_BLOCKED_RAD = 0.004  # less than three ticks of 4096
_CONTACT_LOAD_PERCENT = 0.4  # fraction of its maximum, as the servo reports it
_TIME_TOLERANCE_S = 1.5  # at rest for so long without load is no stop


class ContactState(Enum):
    """State of a joint that is driven towards its stop."""

    MOVING = "it moves"
    STOP = "it presses against something"
    NO_CONTACT = "it does not move although nothing holds it"


@dataclass(frozen=True, slots=True)
class EndStopDetector:
    """Detects the stop of one joint; angles are of the servo's horn.

    Static friction and gravity hold a joint until its servo presses with as much torque as it may.
    So a joint at rest is at a stop only when its lag is so large that the servo does.

    Attributes:
        max_load_percent: The load limit of its servo.
        min_lag_rad: How far it must be behind its goal.
        contact: The state of the joint.
        since_s: When it last moved; infinity before the first sample.
        at_rad: Its position then.
    """

    max_load_percent: float
    min_lag_rad: float
    contact: ContactState = ContactState.MOVING
    since_s: float = math.inf
    at_rad: float = 0.0

    def may_be_blocked(self, at_s: float, at_rad: float, goal_rad: float) -> bool:
        """Check whether the load must be checked: at rest behind its goal for long enough."""
        at_rest_s = at_s - self.update(at_s, at_rad).since_s
        return at_rest_s >= _BLOCKED_S and abs(goal_rad - at_rad) >= self.min_lag_rad

    def update(self, at_s: float, at_rad: float) -> EndStopDetector:
        """Add one more position sample."""
        if self.since_s == math.inf or abs(at_rad - self.at_rad) > _BLOCKED_RAD:
            return replace(self, since_s=at_s, at_rad=at_rad, contact=ContactState.MOVING)
        return self

    def update_with_load(
        self, at_s: float, at_rad: float, goal_rad: float, load_percent: float
    ) -> EndStopDetector:
        """Add one more sample of position and load.

        Args:
            at_s: The time.
            at_rad: The position of the horn.
            goal_rad: Its goal.
            load_percent: The load that its servo reports; the sign is ignored.
        """
        updated = self.update(at_s, at_rad)
        if not self.may_be_blocked(at_s, at_rad, goal_rad):
            return updated
        if abs(load_percent) >= _CONTACT_LOAD_PERCENT * self.max_load_percent:
            return replace(updated, contact=ContactState.STOP)
        return (
            replace(updated, contact=ContactState.NO_CONTACT)
            if at_s - updated.since_s >= _TIME_TOLERANCE_S
            else updated
        )

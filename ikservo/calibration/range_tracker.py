"""Range tracking of one joint: unwrapped ticks, standstill and end-stop detection.

One of the three alone deceives. A joint stands still because it has not begun to move; it works
hard because it lifts something; it is late because the bus was busy. Only where it stands for a
while, well behind its goal, and its servo presses as hard as it may, something solid is there.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum

from ikservo.calibration.homing import TickRange
from ikservo.calibration.joint_map import JointMap, unwrap
from ikservo.calibration.limits import Limits

__all__ = [
    "ContactState",
    "EndStopDetector",
    "JointUnderCalibration",
    "RangeTracker",
    "StillnessDetector",
]


# Between two readings a hand turns a joint far less than a quarter turn. After a gap in them
# the turn is ambiguous only if the joint could have gone the other way round meanwhile.
_MAX_STEP = 1024
_MAX_TURNS_PER_S = 1.6  # of a hand: 10 rad/s


@dataclass(frozen=True, slots=True)
class RangeTracker:
    """Where a servo is and was, in bare ticks counted on over the seam.

    Attributes:
        turn: Ticks in a turn, or 0 for a sensor that has no seam.
        tick: Where it is.
        low: The lowest tick seen.
        high: The highest.
        at_s: When it was last read.
        lost: Whether it was moved too fast to be followed; measuring starts again.
    """

    turn: int
    tick: int
    low: int
    high: int
    at_s: float
    lost: bool = False

    @classmethod
    def start_at(cls, turn: int, tick: int, at_s: float) -> RangeTracker:
        """Return a track that begins at a tick."""
        return cls(turn, tick, tick, tick, at_s)

    @property
    def width(self) -> int:
        """Return the ticks between the ends that were seen."""
        return self.high - self.low

    def update(self, reading: int, at_s: float) -> RangeTracker:
        """Return the track with one more reading."""
        tick = unwrap(self.tick, reading, self.turn) if self.turn else reading
        strayed = self.turn and abs(tick - self.tick) > _MAX_STEP
        other_way = self.turn - abs(tick - self.tick)
        ambiguous = other_way <= _MAX_TURNS_PER_S * self.turn * (at_s - self.at_s)
        return replace(
            self,
            tick=tick,
            low=min(self.low, tick),
            high=max(self.high, tick),
            at_s=at_s,
            lost=self.lost or bool(strayed or (self.turn and ambiguous)),
        )

    def update_unwrapped(self, tick: int, at_s: float) -> RangeTracker:
        """Return the track with one more reading whose turn is known."""
        low, high = min(self.low, tick), max(self.high, tick)
        return replace(self, tick=tick, low=low, high=high, at_s=at_s)

    def restarted(self) -> RangeTracker:
        """Return a track that has seen nothing but where it is; the count goes on."""
        return replace(self, low=self.tick, high=self.tick, lost=False)

    def with_range_of(self, earlier: RangeTracker) -> RangeTracker:
        """Return the track where it is, with what was seen earlier, good or lost."""
        lost = self.lost or earlier.lost
        return replace(self, low=earlier.low, high=earlier.high, lost=lost)


_WINDOW_S = 0.5
_NOISE_TICKS = 4


@dataclass(frozen=True, slots=True)
class StillnessDetector:
    """The unwrapped ticks of the last half second, by servo."""

    seen: tuple[tuple[float, Mapping[int, int]], ...] = ()

    def add_reading(self, at_s: float, ticks: Mapping[int, int]) -> StillnessDetector:
        """Return it with one more reading; those older than half a second fall out."""
        kept = [row for row in self.seen if row[0] > at_s - _WINDOW_S]
        older = [row for row in self.seen if row[0] <= at_s - _WINDOW_S][-1:]
        return replace(self, seen=(*older, *kept, (at_s, ticks)))

    def is_at_rest(self) -> bool:
        """Return whether nothing has moved for half a second."""
        if len(self.seen) < 3 or self.seen[-1][0] - self.seen[0][0] < _WINDOW_S:
            return False
        return all(max(column) - min(column) <= _NOISE_TICKS for column in self._ticks_by_servo())

    def mean_ticks(self) -> dict[int, float]:
        """Return the mean tick of each servo over the window."""
        means = (sum(column) / len(column) for column in self._ticks_by_servo())
        return dict(zip(self.seen[-1][1], means, strict=True))

    def _ticks_by_servo(self) -> list[list[int]]:
        return [[ticks[i] for _, ticks in self.seen] for i in self.seen[-1][1]]


_MIN_MOTION_DEG = 15.0


@dataclass(frozen=True, slots=True)
class JointUnderCalibration:
    """What is known of a joint before a hand has touched it.

    Attributes:
        joint_map: Scale and sign as the arm file says; its zero tick is not used.
        turn: Ticks after which the servo's count begins again; 0 where it never does.
        expected: The arm file's range.
        pose: Where the joint is in the anchor pose, rad or m.
        shadow_ids: Servos that turn the joint together with the first.
        known: Its travel in bare ticks where that was measured before; it is then not swept.
    """

    joint_map: JointMap
    turn: int
    expected: Limits
    pose: float
    shadow_ids: tuple[int, ...] = ()
    known: TickRange | None = None

    @property
    def name(self) -> str:
        """Return the joint's name."""
        return self.joint_map.joint

    @property
    def servo_id(self) -> int:
        """Return the id of the servo that answers for the joint."""
        return self.joint_map.servo_id

    @property
    def free_direction(self) -> int:
        """Return the direction, +1 or -1, in which there is more room from the anchor pose."""
        above = self.expected.upper.value - self.pose
        return 1 if above >= self.pose - self.expected.lower.value else -1

    @property
    def expected_ticks(self) -> float:
        """Return how many ticks wide the arm file's range is."""
        low, high = self.expected.lower.value, self.expected.upper.value
        return abs(self.joint_map.ticks_from_zero(high) - self.joint_map.ticks_from_zero(low))

    @property
    def min_motion_ticks(self) -> float:
        """Return how far the joint must move before that shows its direction."""
        return min(_MIN_MOTION_DEG / 360.0 * (self.turn or 1229), 0.25 * self.expected_ticks)

    def zero_tick(self, sign: int, anchor_tick: float) -> float:
        """Return the tick at position zero, given the tick in the anchor pose."""
        return anchor_tick - self.joint_map.with_mounting(sign, 0.0).ticks_from_zero(self.pose)

    def with_mounting(self, sign: int, anchor_tick: float) -> JointMap:
        """Return the joint's map, given the servo's sign and its tick in the anchor pose."""
        return self.joint_map.with_mounting(sign, self.zero_tick(sign, anchor_tick))


_BLOCKED_S = 0.25
_BLOCKED_RAD = 0.004  # less than three ticks of 4096
_MIN_LAG_RAD = 0.045  # a servo that presses with a third of its torque is about so far behind
_CONTACT_LOAD_PERCENT = 0.4  # of what it may, by its own word
_TIME_TOLERANCE_S = 1.5  # standing for so long without pressing is no stop


class ContactState(Enum):
    """What a joint does that is driven towards its stop."""

    MOVING = "it moves"
    STOP = "it stands against something"
    SLACK = "it stands although nothing holds it"


@dataclass(frozen=True, slots=True)
class EndStopDetector:
    """One joint on its way to a stop; angles are of the servo's horn.

    Attributes:
        most_percent: How hard its servo may press.
        touch: What the joint does.
        since_s: When it last moved; None before the first look.
        at_rad: Where it was then.
    """

    most_percent: float
    touch: ContactState = ContactState.MOVING
    since_s: float | None = None
    at_rad: float = 0.0

    def may_be_blocked(self, at_s: float, at_rad: float, goal_rad: float) -> bool:
        """Return whether the load decides now: it stands behind its goal for long enough."""
        seen = self.update(at_s, at_rad)
        standing_s = at_s - (at_s if seen.since_s is None else seen.since_s)
        return standing_s >= _BLOCKED_S and abs(goal_rad - at_rad) >= _MIN_LAG_RAD

    def update(self, at_s: float, at_rad: float) -> EndStopDetector:
        """Return it with one more look at where the joint is."""
        if self.since_s is None or abs(at_rad - self.at_rad) > _BLOCKED_RAD:
            return replace(self, since_s=at_s, at_rad=at_rad, touch=ContactState.MOVING)
        return self

    def update_with_load(
        self, at_s: float, at_rad: float, goal_rad: float, load_percent: float
    ) -> EndStopDetector:
        """Return what a look says.

        Args:
            at_s: When.
            at_rad: Where the horn is.
            goal_rad: Where it is told to go.
            load_percent: How hard its servo says that it presses; the sign is not looked at.
        """
        seen = self.update(at_s, at_rad)
        if not self.may_be_blocked(at_s, at_rad, goal_rad):
            return seen
        if abs(load_percent) >= _CONTACT_LOAD_PERCENT * self.most_percent:
            return replace(seen, touch=ContactState.STOP)
        standing_s = at_s - (at_s if seen.since_s is None else seen.since_s)
        return replace(seen, touch=ContactState.SLACK) if standing_s >= _TIME_TOLERANCE_S else seen

"""The goal of one joint during settling: integrate errors, relieve friction, soften swings."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import Enum, auto

from ikservo.calibration import format_source
from ikservo.guard import DrivenJoint
from ikservo.settling.swings import SwingDamper

_FRACTION_PER_S = 4.0  # the goal moves by this fraction of the error per second
_MIN_RAD_S = 16 * math.tau / 4096  # at the horn, not slower: stiction must be overcome soon
# A servo may have less friction than the model, by this fraction of both directions together.
_FRICTION_MARGIN = 0.15
# A joint that swung in its backlash is corrected again once it rests, slower each time [rad/s at
# the horn], because it must not coast across its backlash.
_SWUNG_RAD_S = (0.015, 0.01)
# It drifts on in its backlash when its goal has stopped; reversing then would throw it again.
_SWUNG_ENOUGH_TICKS = 3
# Near its target, the correction waits for a joint that has just moved, because it still slides.
_NEAR_TICKS = 3
_MIN_WAIT_S = 0.04
_AT_REST_S = 0.06
# A joint without load may stay this long where it reverses in its backlash; its rotor crosses that
# after its goal has moved.
_UNLOADED_REST_S = 0.15
# Sensor noise is below this.
_NOISE_TICKS = 1
_IDLE_TICKS = 3  # a joint that only has to come to rest, such as a gripper, may flicker by this


class Saturation(Enum):
    """The kind of limit that ends a joint's correction."""

    LOAD = auto()
    """The goal leads the joint by as much as the guard allows at rest."""
    LIMIT = auto()
    """The goal is at a joint limit."""


@dataclass(frozen=True, slots=True)
class SaturationReason:
    """The reason why the goal of a joint cannot move further.

    Attributes:
        kind: The kind of limit.
        text: The text for the user, with the active limit and its source.
    """

    kind: Saturation
    text: str


class GoalIntegrator:
    """Integrator of a joint's error into its goal.

    Correction ends at the target tick. A joint without load sticks and then jumps by a tick or two.
    When the joint has crossed the target, or is pressed away from it, an error of one tick is
    accepted, because a reversal would cross the backlash and make the joint jump further. Each time
    the joint jumps over the target again, the accepted error doubles. When the joint arrives, its
    goal is moved back from the edge of the friction band, so that friction does not release the
    joint again. The servo of a joint that swings is softened until the joint rests
    (``SwingDamper``); the joint is then corrected slowly. If correction starts swings repeatedly,
    the goal stays.

    Args:
        driven: The joint with its servo and limits.
        goal: The goal, ticks.
        target: The target of the joint, ticks; None if it only has to come to rest.
        acceleration: The maximum change of the goal's speed, ticks/s².
        stuck: Lowest and highest lead at which friction is expected to hold the joint, ticks; the
            goal crosses this range fast. Two equal numbers if unknown.

    Attributes:
        goal: The goal of a joint at rest, ticks with fraction.
        at: The last measured position, ticks.
        still_since_s: Time since which the joint is within sensor noise of its position.
        moved_s: Time of the last change of position; changes back due to noise do not count.
    """

    def __init__(
        self,
        driven: DrivenJoint,
        goal: int,
        target: int | None,
        acceleration: float,
        stuck: tuple[float, float] = (0.0, 0.0),
    ) -> None:
        self.driven, self.goal, self.target = driven, float(goal), target
        low, high = driven.tick_range
        self._low, self._high = min(low, goal), max(high, goal)
        self._acceleration, self._stuck = acceleration, stuck
        self._slowest = _MIN_RAD_S / driven.joint_map.horn_rad_per_tick
        self._swung_speeds = [each / driven.joint_map.horn_rad_per_tick for each in _SWUNG_RAD_S]
        self._lead = driven.max_lead_ticks(0.0)
        self.at = self._before = self._anchor = goal if target is None else target
        self.moved_s, self.still_since_s = -math.inf, 0.0
        self._unloaded = stuck[0] < 0.0 < stuck[1]
        self._side, self._furthest, self._enough = 0, 0, int(self._unloaded)
        self._rate, self._released_s, self._relief = 0.0, -math.inf, 1.0
        self._pushed = False
        self._swing = SwingDamper()

    @property
    def error_ticks(self) -> int:
        """The error of the joint in ticks, signed."""
        return 0 if self.target is None else self.target - self.at

    @property
    def arrived(self) -> bool:
        """Whether the joint is as close to its target as possible."""
        beside = abs(self.error_ticks)
        low, high = self._stuck
        # Gears without load would have to change their flank on the way to the target.
        would_cross_backlash = low < 0.0 < high and self._side * (self.goal - self.at) < 0.0
        return beside <= self._enough or (beside == 1 and would_cross_backlash)

    @property
    def swings(self) -> bool:
        """Whether the joint is not corrected because it swings or has swung too often."""
        return self._swing.swings

    @property
    def has_swung(self) -> bool:
        """Whether the joint swings, or has swung and may do so again."""
        return self._swing.swings or self._swing.rests > 0

    @property
    def swing_ticks(self) -> int:
        """The distance between the last two reversals of the joint."""
        return self._swing.ticks

    def has_swung_at(self, time_s: float) -> bool:
        """Check whether the joint has swung for so long that settling no longer waits for it."""
        return self._swing.has_swung_at(time_s)

    @property
    def saturation_reason(self) -> SaturationReason | None:
        """The reason why the goal cannot move further; None if it can."""
        if self._is_lead_limited():
            return SaturationReason(Saturation.LOAD, "load too high (correction limit reached)")
        if self.arrived or not self._is_at_limit():
            return None
        limits = self.driven.limits
        upper = self.driven.joint_map.sign * self._side > 0
        limit = limits.upper if upper else limits.lower
        value, source = self.driven.joint_map.format(limit.value), format_source(limit.source)
        return SaturationReason(Saturation.LIMIT, f"at its limit {value} ({source})")

    def moves_at(self, time_s: float) -> bool:
        """Check whether the joint was moving at the time of the last update.

        A joint that friction has just released may not yet have moved further than noise.
        """
        low, high = self._stuck
        still_s = time_s - max(self.still_since_s, self._released_s)
        last_s = time_s - self.moved_s
        if self.target is None:
            return still_s < _AT_REST_S
        if low < 0.0 < high and min(still_s, self._swing.steady_s) < _UNLOADED_REST_S:
            return True
        return still_s < _AT_REST_S or last_s < _MIN_WAIT_S or self._swing.may_swing(still_s)

    def goal_at(self, after_s: float) -> float:
        """Compute the goal's tick at a time after the last update.

        A goal outside the limits that has moved closer to them does not move back out.
        """
        goal = self._inside(self.goal + self._rate * after_s + self._along)
        low, high = self.driven.tick_range
        self._low, self._high = min(low, max(self._low, goal)), max(high, min(self._high, goal))
        return goal

    def update(
        self, tick: int, time_s: float, elapsed_s: float, *, correcting: bool = True
    ) -> None:
        """Process the measured position, and choose the speed of the goal; 0 if not correcting."""
        self.goal = self._inside(self.goal + self._rate * elapsed_s)
        if self._rate and self._side * (tick - self.at) > 0:
            self._released_s = time_s  # perhaps
        self._track_motion(tick, time_s)
        if self._pushed and self.arrived:
            self._relieve(time_s)
        self._swing.update(tick, time_s, elapsed_s, goal_moves=bool(self._rate))
        if self.swings and self._swing.rests < len(_SWUNG_RAD_S) and not self.moves_at(time_s):
            # The swing has ended: the goal continues from here, so that the torque stays.
            self.goal = self._inside(self.goal + self._along)
            self._swing.rest()
            self._furthest, self._enough = 0, _SWUNG_ENOUGH_TICKS
        speed = self._desired_speed(time_s) if correcting else 0.0
        change = self._acceleration * elapsed_s
        self._rate = min(max(speed, self._rate - change), self._rate + change) if speed else 0.0
        self._pushed = self._pushed or self._rate != 0.0

    def _relieve(self, time_s: float) -> None:
        """Move the goal back from where friction has just released the joint, or soon would."""
        low, high = self._stuck
        goal = (self.at if self.target is None else self.target) + 0.5 * (low + high)
        most, back = 0.5 * (high - low), goal - self.goal
        if not self._unloaded:
            back = -self._side * max(-self._side * back, 0.0)
        # More could drop a joint that carries what the model does not know.
        self.goal = self._inside(self.goal + self._relief * min(max(back, -most), most))
        self._released_s, self._pushed = time_s, False
        self._relief *= 0.5  # a load that the model does not know may have moved the joint back

    def _track_motion(self, tick: int, time_s: float) -> None:
        if tick != self.at:
            if tick != self._before:  # returning to the previous tick is noise
                self.moved_s = time_s
            self._before, self.at = self.at, tick
        if abs(tick - self._anchor) > (_IDLE_TICKS if self.target is None else _NOISE_TICKS):
            self._anchor, self.still_since_s = tick, time_s
        side = (self.error_ticks > 0) - (self.error_ticks < 0)
        if side * self._side < 0:
            if self._furthest > self._enough:
                self._enough = 2 * self._enough or 1
            self._furthest = 0
        self._furthest = max(self._furthest, abs(self.error_ticks))
        self._side = side or self._side

    @property
    def _along(self) -> float:
        """Displacement of the goal in phase with a swing; 0 if the joint only needs to rest."""
        return 0.0 if self.target is None else self._swing.goal_ticks

    def _inside(self, goal: float) -> float:
        return min(max(goal, self._low), self._high)

    def _desired_speed(self, time_s: float) -> float:
        """Compute the desired speed of the goal, ticks/s, signed."""
        if self.arrived or self.swings or self._is_lead_limited() or self._is_at_limit():
            return 0.0
        if abs(self.error_ticks) <= _NEAR_TICKS and time_s - self.moved_s < _MIN_WAIT_S:
            return 0.0
        if self._swing.rests:
            return math.copysign(self._swung_speeds[self._swing.rests - 1], self.error_ticks)
        slowly = max(_FRACTION_PER_S * abs(self.error_ticks), self._slowest)
        low, high = self._stuck
        lead = self._side * (self.goal - self.at)
        end = max(self._side * low, self._side * high) - _FRICTION_MARGIN * (high - low)
        # At this speed the goal can still stop before friction releases the joint.
        while_stuck = math.sqrt(2.0 * self._acceleration * max(end - lead, 0.0))
        return math.copysign(max(slowly, while_stuck), self.error_ticks)

    def _is_lead_limited(self) -> bool:
        return not self.arrived and self._side * (self.goal - self.at) >= self._lead

    def _is_at_limit(self) -> bool:
        end = self._high if self._side > 0 else self._low
        return self._side * (end - self.goal) <= 0

"""What one servo may be told: a range in whole ticks and the speed of its goals."""

from __future__ import annotations

import math
from dataclasses import dataclass

from ikservo.calibration import JointMap, JointUnit, Limits, say, source_words

__all__ = ["Fence"]

# A joint that must not travel further than 60 ticks of 4096 when its program dies; and what a
# P-controlled servo stands behind its goal under load, or is made to lead by to make up for it.
_LOOK_S = 0.1
_MOST_TRAVEL_RAD = 60 * math.tau / 4096
_STANDING_RAD = 0.12


@dataclass(frozen=True, slots=True)
class Fence:
    """The range and speed of one joint, in the servo's own ticks.

    Attributes:
        joint_map: How ticks and positions relate.
        limits: The calibrated range, each end with its source.
        speed: How fast goals may move, rad/s or m/s.
    """

    joint_map: JointMap
    limits: Limits
    speed: float

    @property
    def joint(self) -> str:
        """Return the joint's name."""
        return self.joint_map.joint

    @property
    def servo_id(self) -> int:
        """Return the id of the servo that turns the joint."""
        return self.joint_map.servo_id

    @property
    def ticks(self) -> tuple[int, int]:
        """Return the lowest and the highest tick inside the limits."""
        return self.joint_map.ticks_inside(self.limits.lower.value, self.limits.upper.value)

    @property
    def positions(self) -> tuple[float, float]:
        """Return the lowest and the highest position that is a whole tick inside the limits."""
        low, high = sorted(self.joint_map.position(tick) for tick in self.ticks)
        return low, high

    def tick(self, position: float) -> int:
        """Return the whole tick nearest to a position, inside the limits where the position is.

        Raises:
            BadValueError: The position is not finite.
        """
        tick = self.joint_map.tick(position)
        if not self.limits.holds(position):
            return tick
        low, high = self.ticks
        return min(max(tick, low), high)

    @property
    def ticks_s(self) -> float:
        """Return how fast goals may move, ticks a second."""
        return self.speed / self.joint_map.unit_per_tick

    def lead_ticks(self, speed: float) -> int:
        """Return how far a goal may be ahead of the measured joint in a motion.

        That is what a motion of this speed [rad/s or m/s] goes through in 0.1 s, but no more than
        60 ticks of 4096 on the horn; and besides what a servo stands behind under load.
        """
        horn = self.joint_map.horn_rad_per_tick
        moving = min(
            min(speed, self.speed) * _LOOK_S / self.joint_map.unit_per_tick, _MOST_TRAVEL_RAD / horn
        )
        return math.floor(moving + 1e-6) + math.floor(_STANDING_RAD / horn)

    def beyond(self, tick: int) -> str:
        """Return in words how a tick leaves the range, with the binding limit and its source."""
        position = self.joint_map.position(tick)
        above = position > self.limits.upper.value
        limit = self.limits.upper if above else self.limits.lower
        target, bound = _told_apart(position, limit.value, self.joint_map.unit)
        side = "above its upper" if above else "below its lower"
        return (
            f"{self.joint} target {target} is {side} limit {bound} ({source_words(limit.source)})."
        )


def _told_apart(a: float, b: float, unit: JointUnit) -> tuple[str, str]:
    """Return two positions in words, with a second decimal where one would not tell them apart."""
    digits = 1 if say(a, unit) != say(b, unit) else 2
    return say(a, unit, digits), say(b, unit, digits)

"""A joint that is to be calibrated, as the arm file has it."""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.calibration.sweeping.homing import Travel
from ikservo.calibration.ticks.joint_map import JointMap
from ikservo.calibration.ticks.limits import Limits

__all__ = ["Subject"]

_ENOUGH_DEG = 15.0


@dataclass(frozen=True, slots=True)
class Subject:
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
    known: Travel | None = None

    @property
    def name(self) -> str:
        """Return the joint's name."""
        return self.joint_map.joint

    @property
    def servo_id(self) -> int:
        """Return the id of the servo that answers for the joint."""
        return self.joint_map.servo_id

    @property
    def towards(self) -> int:
        """Return the direction, +1 or -1, in which there is more room from the anchor pose."""
        above = self.expected.upper.value - self.pose
        return 1 if above >= self.pose - self.expected.lower.value else -1

    @property
    def expected_ticks(self) -> float:
        """Return how many ticks wide the arm file's range is."""
        low, high = self.expected.lower.value, self.expected.upper.value
        return abs(self.joint_map.ticks_from_zero(high) - self.joint_map.ticks_from_zero(low))

    @property
    def enough_ticks(self) -> float:
        """Return how far the joint must move before that shows its direction."""
        return min(_ENOUGH_DEG / 360.0 * (self.turn or 1229), 0.25 * self.expected_ticks)

    def zero_tick(self, sign: int, anchor_tick: float) -> float:
        """Return the tick at position zero, given the tick in the anchor pose."""
        return anchor_tick - self.joint_map.placed(sign, 0.0).ticks_from_zero(self.pose)

    def placed(self, sign: int, anchor_tick: float) -> JointMap:
        """Return the joint's map, given the servo's sign and its tick in the anchor pose."""
        return self.joint_map.placed(sign, self.zero_tick(sign, anchor_tick))

"""Data about a joint before its calibration."""

from __future__ import annotations

from dataclasses import dataclass

from ikservo.calibration.homing import TickRange
from ikservo.calibration.joint_limits import Limits
from ikservo.calibration.joint_map import JointMap

_MIN_MOTION_DEG = 15.0


@dataclass(frozen=True, slots=True)
class JointUnderCalibration:
    """A joint that is about to be calibrated.

    Attributes:
        joint_map: Scale and sign from the arm file; the zero tick is not used.
        ticks_per_turn: Ticks after which the servo's count wraps around; 0 if it never does.
        expected: The arm file's range.
        pose: The joint position in the reference pose, rad or m.
        shadow_ids: Servos that drive the joint together with the first servo.
        known: The travel in encoder ticks if it was measured before; it is then not recorded again.
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
        """Width of the arm file's range in ticks."""
        low, high = self.expected.lower.value, self.expected.upper.value
        return abs(self.joint_map.ticks_from_zero(high) - self.joint_map.ticks_from_zero(low))

    @property
    def min_motion_ticks(self) -> float:
        """Distance in ticks that the joint must move to show its direction."""
        return min(
            _MIN_MOTION_DEG / 360.0 * (self.ticks_per_turn or 1229), 0.25 * self.expected_ticks
        )

    def zero_tick(self, sign: int, anchor_tick: float) -> float:
        """Compute the tick at position zero, given the tick in the reference pose."""
        return anchor_tick - self.joint_map.with_mounting(sign, 0.0).ticks_from_zero(self.pose)

    def with_mounting(self, sign: int, anchor_tick: float) -> JointMap:
        """Return the joint's map, given the servo's sign and its tick in the reference pose."""
        return self.joint_map.with_mounting(sign, self.zero_tick(sign, anchor_tick))

"""A driven joint: its range and speed, and the allowed lead of its goals."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from ikservo.calibration import JointMap, Limits, format_position, format_source
from ikservo.errors import RefusedError
from ikservo.guard.goal_lead import at_rest_lead_rad, moving_lead_rad

TickRow = Sequence[int | None]
"""A tick per joint, in the order of an arm's joints; None leaves a joint out."""


@dataclass(frozen=True)
class DrivenJoint:
    """A joint, its servo, and the allowed range and speed of its goals.

    Attributes:
        joint_map: The conversion of ticks and positions.
        limits: The calibrated range, each end with its source.
        speed: The maximum speed of goals, rad/s or m/s.
        stall_error: The distance from a goal at which friction may keep the joint, rad or m.
        lifting_lag_rad: The lag of the horn behind its goal while it lifts arm and payload, rad.
        sag_rad: The lag of the horn behind its goal under the weight of arm and payload at rest,
            rad.
    """

    joint_map: JointMap
    limits: Limits
    speed: float
    stall_error: float = 0.0
    lifting_lag_rad: float = 0.0
    sag_rad: float = 0.0

    @cached_property
    def joint(self) -> str:
        """The joint's name."""
        return self.joint_map.joint

    @cached_property
    def servo_id(self) -> int:
        """The id of the joint's servo."""
        return self.joint_map.servo_id

    @cached_property
    def tick_range(self) -> tuple[int, int]:
        """The lowest and highest tick inside the limits."""
        return self.joint_map.ticks_inside(self.limits.lower.value, self.limits.upper.value)

    @property
    def position_range(self) -> tuple[float, float]:
        """The lowest and highest positions that are integer ticks inside the limits."""
        low, high = sorted(self.joint_map.position(tick) for tick in self.tick_range)
        return low, high

    @property
    def settled_range(self) -> tuple[float, float]:
        """The lowest and highest positions at which friction lets the joint settle.

        No goal may pass a limit, and a joint stops before its goal.
        """
        low, high = self.position_range
        margin = min(self.stall_error, 0.5 * (high - low))
        return low + margin, high - margin

    @property
    def at_rest_lead_rad(self) -> float:
        """The allowed lead of a goal over the measured horn when nothing moves."""
        return at_rest_lead_rad(self.lifting_lag_rad)

    def tick(self, position: float) -> int:
        """Compute the tick nearest to a position; it is inside the limits if the position is.

        Raises:
            BadValueError: The position is not finite.
        """
        tick = self.joint_map.tick(position)
        if not self.limits.contains(position):
            return tick
        low, high = self.tick_range
        return min(max(tick, low), high)

    @property
    def max_ticks_s(self) -> float:
        """The maximum speed of goals, ticks per second."""
        return self.speed / self.joint_map.unit_per_tick

    def max_lead_ticks(self, speed: float) -> int:
        """Compute the allowed lead of a goal over the measured joint in a motion.

        The lead is the distance covered in 0.1 s at this speed [rad/s or m/s], but at most 60 ticks
        of 4096 on the horn, plus the steady-state error of a servo under load: 0.12 rad on the
        horn, or more if the joint needs more to lift the arm and its payload.
        """
        horn, unit_per_tick = self.joint_map.horn_rad_per_tick, self.joint_map.unit_per_tick
        moving_rad = moving_lead_rad(min(speed, self.speed) / unit_per_tick * horn)
        return math.floor(moving_rad / horn + 1e-6) + math.floor(self.at_rest_lead_rad / horn)

    def describe_violation(self, tick: int) -> str:
        """Describe by how much a tick is outside the range; name the limit and its source."""
        position = self.joint_map.position(tick)
        above = position > self.limits.upper.value
        limit = self.limits.upper if above else self.limits.lower
        unit, side = self.joint_map.unit, "above its upper" if above else "below its lower"
        target, bound = (format_position(each, unit) for each in (position, limit.value))
        if target == bound:
            target, bound = (format_position(each, unit, 2) for each in (position, limit.value))
        return (
            f"{self.joint} target {target} is {side} limit {bound} ({format_source(limit.source)})."
        )


def require_int_tick(joint: str, tick: object) -> None:
    """Check that a tick is an integer.

    Raises:
        RefusedError: The tick is not an integer; the error names the joint.
    """
    # bool is an int in Python, but True is not a position.
    if not isinstance(tick, int) or isinstance(tick, bool):
        raise RefusedError(f"The goal of {joint} is {tick!r}.", "Expected a whole number of ticks.")

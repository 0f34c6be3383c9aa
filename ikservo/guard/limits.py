"""Limits of commanded positions: joint limits, lead over the measured joint, whole ticks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ikservo.calibration import JointMap, JointUnit, Limits, format_position, format_source
from ikservo.errors import RefusedError

__all__ = ["MAX_TRAVEL_RAD", "DrivenJoint", "LeadLimiter", "require_int_tick"]


MAX_TRAVEL_RAD = 60 * math.tau / 4096
"""How far a horn may travel after its program has died: 60 ticks of 4096."""

# A goal leads a moving joint by no more than that; in addition, the steady-state error of a
# P-controlled servo under load, or the lead that compensates it. The first number is what any joint
# may need; no joint of an arm file gets more than the second.
_LEAD_TIME_S = 0.1
_AT_REST_LEAD_RAD, _MAX_AT_REST_LEAD_RAD = 0.12, 0.2


@dataclass(frozen=True, slots=True)
class DrivenJoint:
    """A joint, its servo, and the range and speed that its goals may have.

    Attributes:
        joint_map: The conversion of ticks and positions.
        limits: The calibrated range, each end with its source.
        speed: The maximum speed of goals, rad/s or m/s.
        stall_error: How far short of a goal friction may keep the joint, rad or m.
        lifting_lag_rad: How far behind its goal the horn is while it lifts arm and payload, rad.
        sag_rad: How far behind its goal the weight of arm and payload keeps the horn, rad.
    """

    joint_map: JointMap
    limits: Limits
    speed: float
    stall_error: float = 0.0
    lifting_lag_rad: float = 0.0
    sag_rad: float = 0.0

    @property
    def joint(self) -> str:
        """The joint's name."""
        return self.joint_map.joint

    @property
    def servo_id(self) -> int:
        """The id of the joint's servo."""
        return self.joint_map.servo_id

    @property
    def tick_range(self) -> tuple[int, int]:
        """The lowest and the highest tick inside the limits."""
        return self.joint_map.ticks_inside(self.limits.lower.value, self.limits.upper.value)

    @property
    def position_range(self) -> tuple[float, float]:
        """The lowest and the highest position that is an integer tick inside the limits."""
        low, high = sorted(self.joint_map.position(tick) for tick in self.tick_range)
        return low, high

    @property
    def settled_range(self) -> tuple[float, float]:
        """The lowest and the highest position to which friction lets the joint settle.

        No goal may pass a limit, and a joint stops short of its goal.
        """
        low, high = self.position_range
        margin = min(self.stall_error, 0.5 * (high - low))
        return low + margin, high - margin

    @property
    def sinks_far(self) -> bool:
        """Whether a servo that takes its position for its goal sinks far under the arm.

        That is by more than ``MAX_TRAVEL_RAD``, with its payload in the heaviest posture.
        """
        return self.sag_rad > MAX_TRAVEL_RAD

    @property
    def at_rest_lead_rad(self) -> float:
        """How far a goal may be ahead of the measured horn when nothing moves."""
        return min(max(self.lifting_lag_rad, _AT_REST_LEAD_RAD), _MAX_AT_REST_LEAD_RAD)

    def tick(self, position: float) -> int:
        """Compute the tick nearest to a position, inside the limits if the position is.

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
        """The maximum speed of goals, ticks a second."""
        return self.speed / self.joint_map.unit_per_tick

    def max_lead_ticks(self, speed: float) -> int:
        """Compute how far a goal may be ahead of the measured joint in a motion.

        That is the distance in 0.1 s at this speed [rad/s or m/s], but no more than 60 ticks of
        4096 on the horn; plus the steady-state error of a servo under load: 0.12 rad on the horn,
        or more where the joint needs it to lift the arm and its payload.
        """
        horn = self.joint_map.horn_rad_per_tick
        moving = min(
            min(speed, self.speed) * _LEAD_TIME_S / self.joint_map.unit_per_tick,
            MAX_TRAVEL_RAD / horn,
        )
        return math.floor(moving + 1e-6) + math.floor(self.at_rest_lead_rad / horn)

    def describe_violation(self, tick: int) -> str:
        """Describe how a tick leaves the range, with the active limit and its source."""
        position = self.joint_map.position(tick)
        above = position > self.limits.upper.value
        limit = self.limits.upper if above else self.limits.lower
        target, bound = _format_distinct(position, limit.value, self.joint_map.unit)
        side = "above its upper" if above else "below its lower"
        return (
            f"{self.joint} target {target} is {side} limit {bound} ({format_source(limit.source)})."
        )


def _format_distinct(a: float, b: float, unit: JointUnit) -> tuple[str, str]:
    """Format two positions, with a second decimal if they would be equal with one."""
    digits = 1 if format_position(a, unit) != format_position(b, unit) else 2
    return format_position(a, unit, digits), format_position(b, unit, digits)


def require_int_tick(joint: str, tick: object) -> None:
    """Check that a tick is an integer.

    Raises:
        RefusedError: It is not; names the joint.
    """
    # bool is an int in Python, but True is not a position.
    if not isinstance(tick, int) or isinstance(tick, bool):
        raise RefusedError(f"The goal of {joint} is {tick!r}.", "Expected a whole number of ticks.")


# A measurement older than this is stale.
_STALE_S = 0.25
# From this fraction of the lead on a motion slows down, so that it need not stop at the end of it.
_EASE_FROM = 0.75


class LeadLimiter:
    """Limits the lead of goals over the measured joints.

    A goal further ahead than `DrivenJoint.max_lead_ticks` is refused, unless it is the present
    goal or on the path back from it; so is a goal of a joint that was not measured recently.

    Args:
        limits: One for each joint.
    """

    def __init__(self, limits: Sequence[DrivenJoint]) -> None:
        self._limits = {limit.joint: limit for limit in limits}
        self._measured: dict[str, tuple[int, float]] = {}
        self.set_speeds({})

    @property
    def measured_ticks(self) -> dict[str, int]:
        """The last measured tick of each joint."""
        return {joint: tick for joint, (tick, _) in self._measured.items()}

    def set_speeds(self, speeds: Mapping[str, float]) -> None:
        """Set the maximum speeds of the motion, rad/s or m/s; by default those of the limits.

        Raises:
            RefusedError: A speed is not above zero.
        """
        speeds_by_joint = {joint: limit.speed for joint, limit in self._limits.items()} | dict(
            speeds
        )
        for joint, speed in speeds_by_joint.items():
            if not speed > 0.0:
                raise RefusedError(
                    f"The speed of {joint} must be above zero, not {speed} rad/s.",
                    "Nothing was sent.",
                )
        self._leads = {
            j: driven.max_lead_ticks(speeds_by_joint[j]) for j, driven in self._limits.items()
        }
        self._ticks_s = {
            j: min(speeds_by_joint[j] / driven.joint_map.unit_per_tick, driven.max_ticks_s)
            for j, driven in self._limits.items()
        }

    def update_measured(self, ticks: Mapping[str, int], time_s: float) -> None:
        """Update the positions measured at a time; joints without a reply are left out.

        Raises:
            RefusedError: A tick is not an integer, or the time not finite.
        """
        if not math.isfinite(time_s):
            raise RefusedError(f"The time of a measurement is {time_s} s.", "It was ignored.")
        for joint, tick in ticks.items():
            require_int_tick(joint, tick)
        self._measured |= {joint: (tick, time_s) for joint, tick in ticks.items()}

    def check_lead(self, joint: str, tick: int, last: int, now_s: float) -> None:
        """Check the lead of one goal over the measured position.

        Args:
            joint: Its name.
            tick: The goal.
            last: The present goal.
            now_s: The time.

        Raises:
            RefusedError: The lead is too large, or the joint was not measured recently.
        """
        measured, lead = self._require_measured(joint, now_s), self._leads[joint]
        if not min(measured - lead, last) <= tick <= max(measured + lead, last):
            raise RefusedError(
                f"Following error: the setpoint of {joint} would be {abs(tick - measured)} ticks "
                f"ahead of its position (max {lead}); stopped.",
                "Check whether something blocks the joint.",
            )

    def stale_joints(self, now_s: float) -> tuple[str, ...]:
        """Return the joints without a position reading of the last 0.25 s."""
        return tuple(joint for joint in self._limits if self._recent_tick(joint, now_s) is None)

    def remaining_lead(self, joint: str, last: int, direction: int, now_s: float) -> int:
        """Compute how many ticks a goal may move on from ``last`` in a direction, +1 or -1.

        Raises:
            RefusedError: The joint was not measured recently.
        """
        measured, lead = self._require_measured(joint, now_s), self._leads[joint]
        return max(lead - direction * (last - measured), 0)

    def allowed_advance_s(self, goals: Mapping[str, int], elapsed_s: float) -> float:
        """Return by how much a motion may advance in a time: less where a joint lags behind.

        Goals within the speeds of `set_speeds` stay within the maximum lead.

        Args:
            goals: The present goals.
            elapsed_s: The time since they were sent.
        """
        return min(
            (self._allowed_joint_advance_s(j, goals[j], elapsed_s) for j in goals),
            default=elapsed_s,
        )

    def ease(self, joint: str, goal: int) -> float:
        """Compute how fast goals may go on, 0 to 1: less from three quarters of the lead on.

        Args:
            joint: Its name.
            goal: Its present goal.
        """
        if joint not in self._measured:
            return 0.0
        ahead = abs(goal - self._measured[joint][0])
        return min(max((1.0 - ahead / self._leads[joint]) / (1.0 - _EASE_FROM), 0.0), 1.0)

    def _allowed_joint_advance_s(self, joint: str, goal: int, elapsed_s: float) -> float:
        if joint not in self._measured:
            return 0.0
        # One tick is left for rounding.
        remaining = self._leads[joint] - 1 - abs(goal - self._measured[joint][0])
        allowed_s = min(self.ease(joint, goal) * elapsed_s, remaining / self._ticks_s[joint])
        return max(allowed_s, 0.0)

    def _require_measured(self, joint: str, now_s: float) -> int:
        tick = self._recent_tick(joint, now_s)
        if tick is None:
            raise RefusedError(
                f"No position reading from {joint} for {_STALE_S} s; motion stopped.",
                "Check the cable and the computer's load.",
            )
        return tick

    def _recent_tick(self, joint: str, now_s: float) -> int | None:
        if joint not in self._measured:
            return None
        tick, measured_s = self._measured[joint]
        return tick if now_s - measured_s <= _STALE_S else None

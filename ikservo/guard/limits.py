"""Limits of commanded positions: joint limits, lead over the measured joint, whole ticks."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from ikservo.calibration import JointMap, JointUnit, Limits, format_position, source_words
from ikservo.errors import RefusedError

__all__ = ["CommandLimits", "LeadLimiter", "require_int_tick"]


# A joint that must not travel further than 60 ticks of 4096 when its program dies; and what a
# P-controlled servo stands behind its goal under load, or is made to lead by to make up for it.
_LEAD_TIME_S = 0.1
_MAX_LEAD_RAD = 60 * math.tau / 4096
_AT_REST_LEAD_RAD = 0.12


@dataclass(frozen=True, slots=True)
class CommandLimits:
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
    def tick_range(self) -> tuple[int, int]:
        """Return the lowest and the highest tick inside the limits."""
        return self.joint_map.ticks_inside(self.limits.lower.value, self.limits.upper.value)

    @property
    def position_range(self) -> tuple[float, float]:
        """Return the lowest and the highest position that is a whole tick inside the limits."""
        low, high = sorted(self.joint_map.position(tick) for tick in self.tick_range)
        return low, high

    def tick(self, position: float) -> int:
        """Return the whole tick nearest to a position, inside the limits where the position is.

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
        """Return how fast goals may move, ticks a second."""
        return self.speed / self.joint_map.unit_per_tick

    def max_lead_ticks(self, speed: float) -> int:
        """Return how far a goal may be ahead of the measured joint in a motion.

        That is what a motion of this speed [rad/s or m/s] goes through in 0.1 s, but no more than
        60 ticks of 4096 on the horn; and besides what a servo stands behind under load.
        """
        horn = self.joint_map.horn_rad_per_tick
        moving = min(
            min(speed, self.speed) * _LEAD_TIME_S / self.joint_map.unit_per_tick,
            _MAX_LEAD_RAD / horn,
        )
        return math.floor(moving + 1e-6) + math.floor(_AT_REST_LEAD_RAD / horn)

    def describe_violation(self, tick: int) -> str:
        """Return in words how a tick leaves the range, with the binding limit and its source."""
        position = self.joint_map.position(tick)
        above = position > self.limits.upper.value
        limit = self.limits.upper if above else self.limits.lower
        target, bound = _format_distinct(position, limit.value, self.joint_map.unit)
        side = "above its upper" if above else "below its lower"
        return (
            f"{self.joint} target {target} is {side} limit {bound} ({source_words(limit.source)})."
        )


def _format_distinct(a: float, b: float, unit: JointUnit) -> tuple[str, str]:
    """Return two positions in words, with a second decimal where one would not tell them apart."""
    digits = 1 if format_position(a, unit) != format_position(b, unit) else 2
    return format_position(a, unit, digits), format_position(b, unit, digits)


def require_int_tick(joint: str, tick: object) -> None:
    """Check that a tick is a whole number.

    Raises:
        RefusedError: It is not; names the joint.
    """
    # bool is an int in Python, and True is no place to drive a joint to.
    if not isinstance(tick, int) or isinstance(tick, bool):
        raise RefusedError(f"The goal of {joint} is {tick!r}.", "Expected a whole number of ticks.")


# Older than this nobody knows where a joint is.
_STALE_S = 0.25
# From this share of the look-ahead on a motion goes slower, so that it need not stop at its end.
_EASE_FROM = 0.75


class LeadLimiter:
    """Keeps goals near where the joints were last seen.

    A goal further ahead than `CommandLimits.max_lead_ticks` is refused, unless it is the present
    goal or on the way back from it; and so is one for a joint that was not seen lately.

    Args:
        fences: One for each joint.
    """

    def __init__(self, fences: Sequence[CommandLimits]) -> None:
        self._fences = {fence.joint: fence for fence in fences}
        self._seen: dict[str, tuple[int, float]] = {}
        self.set_speeds({})

    @property
    def measured_ticks(self) -> dict[str, int]:
        """Return the tick at which each joint was last seen."""
        return {joint: tick for joint, (tick, _) in self._seen.items()}

    def set_speeds(self, speeds: Mapping[str, float]) -> None:
        """Take the top speeds of the motion that runs, rad/s or m/s; the fences' where left out.

        Raises:
            RefusedError: A speed is not above zero.
        """
        wanted = {joint: fence.speed for joint, fence in self._fences.items()} | dict(speeds)
        for joint, speed in wanted.items():
            if not speed > 0.0:
                raise RefusedError(
                    f"The speed of {joint} must be above zero, not {speed} rad/s.",
                    "Nothing was sent.",
                )
        self._leads = {j: f.max_lead_ticks(wanted[j]) for j, f in self._fences.items()}
        self._ticks_s = {
            j: min(wanted[j] / f.joint_map.unit_per_tick, f.max_ticks_s)
            for j, f in self._fences.items()
        }

    def update_measured(self, ticks: Mapping[str, int], time_s: float) -> None:
        """Take where joints were measured at a time; those that did not answer are left out.

        Raises:
            RefusedError: A tick is no whole number, or the time no number.
        """
        if not math.isfinite(time_s):
            raise RefusedError(f"The time of a measurement is {time_s} s.", "It was ignored.")
        for joint, tick in ticks.items():
            require_int_tick(joint, tick)
        self._seen |= {joint: (tick, time_s) for joint, tick in ticks.items()}

    def check_lead(self, joint: str, tick: int, last: int, now_s: float) -> None:
        """Check one goal against where the joint is.

        Args:
            joint: Its name.
            tick: The goal.
            last: The goal that stands.
            now_s: The time.

        Raises:
            RefusedError: It leads too far, or nobody has seen the joint lately.
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
        return tuple(joint for joint in self._fences if self._recent_tick(joint, now_s) is None)

    def remaining_lead(self, joint: str, last: int, direction: int, now_s: float) -> int:
        """Return how many ticks a goal may go on from ``last`` in a direction, +1 or -1.

        Raises:
            RefusedError: Nobody has seen the joint lately.
        """
        measured, lead = self._require_measured(joint, now_s), self._leads[joint]
        return max(lead - direction * (last - measured), 0)

    def allowed_advance_s(self, goals: Mapping[str, int], elapsed_s: float) -> float:
        """Return by how much a motion may go on in a time: less where a joint lags behind.

        Goals that move no faster than `set_speeds` says stay inside the look-ahead.

        Args:
            goals: The goals that stand.
            elapsed_s: The time since they were sent.
        """
        return min(
            (self._allowed_joint_advance_s(j, goals[j], elapsed_s) for j in goals),
            default=elapsed_s,
        )

    def _allowed_joint_advance_s(self, joint: str, goal: int, elapsed_s: float) -> float:
        if joint not in self._seen:
            return 0.0
        lead, ahead = self._leads[joint], abs(goal - self._seen[joint][0])
        ease = min((1.0 - ahead / lead) / (1.0 - _EASE_FROM), 1.0)
        # One tick is left for rounding.
        room_s = (lead - 1 - ahead) / self._ticks_s[joint]
        return max(min(ease * elapsed_s, room_s), 0.0)

    def _require_measured(self, joint: str, now_s: float) -> int:
        tick = self._recent_tick(joint, now_s)
        if tick is None:
            raise RefusedError(
                f"No position reading from {joint} for {_STALE_S} s; motion stopped.",
                "Check the cable and the computer's load.",
            )
        return tick

    def _recent_tick(self, joint: str, now_s: float) -> int | None:
        tick, seen_s = self._seen.get(joint, (0, -math.inf))
        return tick if now_s - seen_s <= _STALE_S else None

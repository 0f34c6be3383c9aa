"""The checks of one joint's goals: range, speed, and lead over the measured joint."""

from __future__ import annotations

import math

from ikservo.errors import RefusedError
from ikservo.guard.driven_joint import DrivenJoint, require_int_tick

# After a delay of the program, goals may not jump by the distance possible in that time.
MAX_ELAPSED_S = 0.05
# A measurement older than this is stale.
_STALE_S = 0.25
# A motion slows down above this fraction of the maximum lead, so that it need not stop there.
_EASE_FROM = 0.75


class RateLimiter:
    """The step limit of one joint's goals.

    Goals are integer ticks, so a step may be up to one tick longer than the speed allows; the
    next steps are shortened by this excess, because many small steps would otherwise be too fast.

    Args:
        ticks_s: The maximum speed, ticks per second.
    """

    def __init__(self, ticks_s: float) -> None:
        self._ticks_s = ticks_s
        self._spare = 1.0

    def max_step(self, elapsed_s: float) -> int:
        """Compute the maximum step for the time since the last step, ticks."""
        return math.floor(self._remaining_step(elapsed_s) + 1e-6)

    def consume(self, step: int, elapsed_s: float) -> None:
        """Record a step that was sent, so that later steps are shortened by any excess."""
        self._spare = min(self._remaining_step(elapsed_s) - step, 1.0)

    def _remaining_step(self, elapsed_s: float) -> float:
        return self._spare + self._ticks_s * min(max(elapsed_s, 0.0), MAX_ELAPSED_S)


class JointGate:
    """Check of one joint's goals against its limits, its last goal and its last measurement.

    A goal's *lead* is its distance from the measured joint. A goal with a lead of more than
    `DrivenJoint.max_lead_ticks` is refused, unless it is the present goal or between the present
    goal and the joint. A goal of a joint that was not measured recently is also refused.

    Attributes:
        goal: The last goal that was sent; None if no goal is in force.
        measured: The last measured tick; None before the first measurement.
    """

    def __init__(self, driven: DrivenJoint) -> None:
        self.driven = driven
        self.goal: int | None = None
        self.measured: int | None = None
        self._name = driven.joint
        self._range = driven.tick_range
        self._rate = RateLimiter(driven.max_ticks_s)
        self._measured_s = -math.inf
        self.set_speed(driven.speed)

    def set_speed(self, speed: float) -> None:
        """Set the maximum speed of the next motion, rad/s or m/s; lower speeds allow less lead."""
        self._max_lead = self.driven.max_lead_ticks(speed)
        unit_per_tick = self.driven.joint_map.unit_per_tick
        self._ticks_s = min(speed / unit_per_tick, self.driven.max_ticks_s)

    def update_measured(self, tick: int, time_s: float) -> None:
        """Update the measured position at a time by the gate's clock."""
        self.measured, self._measured_s = tick, time_s

    def last_goal(self) -> int:
        """Return the goal that is in force.

        Raises:
            RefusedError: No goal is in force.
        """
        if self.goal is None:
            hint = "Switch its torque on first."
            raise RefusedError(f"The position of {self._name} has not been measured.", hint)
        return self.goal

    def consume_step(self, tick: int, elapsed_s: float) -> None:
        """Record the step to a goal that is sent ``elapsed_s`` after the last goal."""
        self._rate.consume(abs(tick - self.last_goal()), elapsed_s)

    def is_stale(self, now_s: float) -> bool:
        """Check whether the last measurement is too old for a goal to pass."""
        return not now_s - self._measured_s <= _STALE_S  # in this form, NaN counts as stale

    def ease(self) -> float:
        """Compute how fast goals may advance, 0 to 1; below 1 from 3/4 of the maximum lead."""
        lead = self._lead()
        if lead is None:
            return 0.0
        return min(max((1.0 - lead / self._max_lead) / (1.0 - _EASE_FROM), 0.0), 1.0)

    def allowed_advance_s(self, elapsed_s: float) -> float:
        """Compute the time by which a motion may advance: the elapsed time, less if the joint lags.

        Goals within the speed of `set_speed` stay within the maximum lead.
        """
        lead = self._lead()
        if lead is None:
            return 0.0
        remaining = self._max_lead - 1 - lead  # one tick is left for rounding
        return max(min(self.ease() * elapsed_s, remaining / self._ticks_s), 0.0)

    def step_fraction(self, tick: int, elapsed_s: float, now_s: float) -> float:
        """Compute the fraction of the step to a goal that may be sent now.

        A goal that the joint could not reach within 50 ms at full speed is not a late step but a
        jump: its fraction is 1, and `check_goal` refuses it.

        Raises:
            RefusedError: The goal is outside the limits, or the joint was not measured recently.
        """
        last = self.last_goal()
        self.check_range(tick, last)
        step = abs(tick - last)
        if not 0 < step <= self._rate.max_step(MAX_ELAPSED_S):
            return 1.0
        direction = 1 if tick > last else -1
        remaining = max(self._max_lead - direction * (last - self._recent_tick(now_s)), 0)
        return min(self._rate.max_step(elapsed_s), remaining, step) / step

    def check_goal(self, tick: int, elapsed_s: float, now_s: float) -> None:
        """Check a goal of a motion.

        Raises:
            RefusedError: The goal is outside the limits, too far from the last goal or from the
                measured joint, or the joint was not measured recently.
        """
        last = self.last_goal()
        self.check_range(tick, last)
        step, max_step = abs(tick - last), self._rate.max_step(elapsed_s)
        if step > max_step:
            shown_ms = min(elapsed_s, MAX_ELAPSED_S) * 1e3
            raise RefusedError(
                f"Velocity limit: setpoint step of {step} ticks in {shown_ms:.0f} ms for "
                f"{self._name} (max {max_step}); stopped.",
                "Setpoints must not move faster than the highest speed in the arm file.",
            )
        measured, lead = self._recent_tick(now_s), self._max_lead
        if not min(measured - lead, last) <= tick <= max(measured + lead, last):
            raise RefusedError(
                f"Following error: the setpoint of {self._name} would be {abs(tick - measured)} "
                f"ticks ahead of its position (max {lead}); stopped.",
                "Check whether something blocks the joint.",
            )

    def check_hold_goal(self, tick: int) -> None:
        """Check that a goal holds the joint: it lies between the last goal and the measured joint.

        Raises:
            RefusedError: The goal would move the joint.
        """
        last = self.last_goal()
        measured = last if self.measured is None else self.measured
        if not min(last, measured) <= tick <= max(last, measured):
            raise RefusedError(
                f"Setpoint {tick} would move {self._name}, which has to stay between tick "
                f"{measured} and its setpoint {last}.",
                "Nothing was sent.",
            )

    def check_range(self, tick: int, start: int) -> None:
        """Check that a goal is inside the limits, or on the path back to them from a start tick.

        Raises:
            RefusedError: The goal is outside, or not an integer.
        """
        require_int_tick(self._name, tick)
        low, high = self._range
        if not min(low, start) <= tick <= max(high, start):
            violation = self.driven.describe_violation(tick)
            raise RefusedError(violation, "Choose a target inside the limits.")

    def clamp(self, tick: int) -> int:
        """Return the nearest tick inside the limits, or on the path back from the last goal.

        Raises:
            RefusedError: No goal is in force, or the tick is not an integer.
        """
        require_int_tick(self._name, tick)
        last, (low, high) = self.last_goal(), self._range
        return min(max(tick, min(low, last)), max(high, last))

    def _lead(self) -> int | None:
        goal, measured = self.goal, self.measured
        return None if goal is None or measured is None else abs(goal - measured)

    def _recent_tick(self, now_s: float) -> int:
        if self.measured is None or self.is_stale(now_s):
            text = f"No position reading from {self._name} for {_STALE_S} s; motion stopped."
            raise RefusedError(text, "Check the cable and the computer's load.")
        return self.measured

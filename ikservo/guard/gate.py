"""The gate that every goal passes before any byte is sent, with its step limit."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from ikservo.clock import Clock
from ikservo.errors import RefusedError
from ikservo.guard.driven_joint import DrivenJoint, TickRow, require_int_tick
from ikservo.guard.joint_gate import MAX_ELAPSED_S, JointGate
from ikservo.guard.stop_latch import StopLatch, StopReason


@dataclass(frozen=True, slots=True)
class PassedGoals:
    """Goals, ticks, that passed the gate at a time of its clock; the caller writes them."""

    ticks: TickRow
    time_s: float


class Gate:
    """Gate that passes commands that satisfy all checks, and refuses other commands as a whole.

    A command consists of goal ticks for some of the joints. It passes if every goal is inside its
    joint's limits, no goal exceeds its joint's top speed, and no goal leads the measured joint by
    more than the maximum lead. A joint outside its limits may be moved back, but never further out.
    After `latch_stop` only `pass_hold` passes, until `acknowledge` and `pass_reset` are called.

    The gate writes nothing: the caller writes what passed, and then commits it. Goals that were
    not committed do not count as sent.

    Args:
        limits: The limits of each joint; commands have one tick per joint in this order.
        clock: Measures the time since the last command.
    """

    def __init__(self, limits: Sequence[DrivenJoint], clock: Clock) -> None:
        self._joints, self._clock = [JointGate(driven) for driven in limits], clock
        self._latch = StopLatch()
        self._passed_s = clock.now_s()

    def pass_reset(self, ticks: TickRow) -> PassedGoals:
        """Pass the measured ticks of the joints as goals, from which later goals start.

        Afterwards torque can be enabled safely: the servos' goals are their positions.

        Raises:
            RefusedError: A tick is not an integer, or the arm was stopped.
        """
        self._latch.raise_if_stopped()
        for joint, tick in self._commanded(ticks):
            require_int_tick(joint.driven.joint, tick)
        return PassedGoals(ticks, self._clock.now_s())

    def update_measured(self, ticks: TickRow, time_s: float) -> None:
        """Update the measured positions, ticks; joints without a reply are left out.

        Goals must stay within the maximum lead of recent measurements. The time is measured by the
        gate's clock.

        Raises:
            RefusedError: A tick is not an integer, or the time not finite.
        """
        if not math.isfinite(time_s):
            raise RefusedError(
                f"The time of a measurement is {time_s} s.", "The measurement was ignored."
            )
        measured = self._commanded(ticks)
        for joint, tick in measured:
            require_int_tick(joint.driven.joint, tick)
        for joint, tick in measured:
            joint.update_measured(tick, time_s)

    def set_speeds(self, speeds: Sequence[float]) -> None:
        """Set the joints' top speeds for the next motion, rad/s or m/s; low speeds allow less lead.

        Raises:
            RefusedError: A speed is not above zero.
        """
        self._require_row(speeds)
        for joint, speed in zip(self._joints, speeds, strict=True):
            if not speed > 0.0:
                text = f"The speed of {joint.driven.joint} must be above zero, not {speed} rad/s."
                raise RefusedError(text, "Nothing was sent.")
        for joint, speed in zip(self._joints, speeds, strict=True):
            joint.set_speed(speed)

    def allowed_advance_s(self, elapsed_s: float) -> float:
        """Return the time by which a motion may advance: the elapsed time, or less if a joint lags.

        A stream that advances its motion by this time, instead of the elapsed one, waits for the
        joints and so stays within the maximum lead.
        """
        elapsed_s = min(elapsed_s, MAX_ELAPSED_S)
        driven = [joint for joint in self._joints if joint.goal is not None]
        return min([joint.allowed_advance_s(elapsed_s) for joint in driven], default=elapsed_s)

    def eases(self) -> list[float]:
        """Return the rate at which each joint's goals may advance, 0 to 1; lower if it lags."""
        return [joint.ease() for joint in self._joints]

    def stale_joints(self, now_s: float) -> tuple[str, ...]:
        """Return the joints whose last position reading is too old for a goal to pass."""
        return tuple([each.driven.joint for each in self._joints if each.is_stale(now_s)])

    def shorten_goals(self, goals: TickRow, now_s: float) -> list[int | None]:
        """Return the allowed goals nearest to the given goals, on the straight path to them.

        Steps that are too long for the time since the last command, or for the maximum lead, are
        shortened, those of all joints by the same fraction. A goal that the joint could not reach
        within 50 ms at full speed is not a late step but a jump; it is returned unchanged, and
        `pass_goals` refuses it. Pass the same time to `pass_goals`.

        Raises:
            RefusedError: A joint would leave its limits or was not measured recently, or a tick is
                not an integer.
        """
        elapsed_s, commanded = now_s - self._passed_s, self._commanded(goals)
        fractions = [joint.step_fraction(tick, elapsed_s, now_s) for joint, tick in commanded]
        fraction = min(fractions, default=1.0)
        if fraction == 1.0:
            return list(goals)
        return [
            None if tick is None else joint.last_goal() + int(fraction * (tick - joint.last_goal()))
            for joint, tick in zip(self._joints, goals, strict=True)
        ]

    def pass_goals(self, goals: TickRow, now_s: float | None = None) -> PassedGoals:
        """Pass goals of a motion.

        Args:
            goals: The goal ticks.
            now_s: The time by the gate's clock for which the goals were computed, so that the
                steps are checked for the same time; None reads the clock.

        Raises:
            RefusedError: One of the goals is not allowed, or the time is not between the last
                command and now; nothing may be sent for any joint.
        """
        self._latch.raise_if_stopped()
        clock_s = self._clock.now_s()
        if now_s is None:
            now_s = clock_s
        # Each elapsed time counts for one step only. This form of the comparison also refuses NaN.
        elif not self._passed_s <= now_s <= clock_s:
            raise RefusedError(
                f"The time of the goals, {now_s} s, is not between that of the last "
                f"command, {self._passed_s} s, and now, {clock_s} s.",
                "Nothing was sent.",
            )
        elapsed_s, commanded = now_s - self._passed_s, self._commanded(goals)
        for joint, tick in commanded:
            joint.check_goal(tick, elapsed_s, now_s)
        for joint, tick in commanded:
            joint.consume_step(tick, elapsed_s)
        return PassedGoals(goals, now_s)

    def pass_hold(self, ticks: TickRow) -> PassedGoals:
        """Pass goals at which joints hold their positions, even while the arm is stopped.

        Each tick is the present goal, the measured tick, or between; it is clamped to the limits.

        Raises:
            RefusedError: A goal would move a joint; nothing may be sent for any joint.
        """
        self._require_row(ticks)
        inside = [
            None if tick is None else joint.clamp(tick)
            for joint, tick in zip(self._joints, ticks, strict=True)
        ]
        for joint, tick in self._commanded(inside):
            joint.check_hold_goal(tick)
        return PassedGoals(inside, self._clock.now_s())

    def commit(self, passed: PassedGoals) -> None:
        """Record that passed goals were sent; later goals start from them."""
        for joint, tick in self._commanded(passed.ticks):
            joint.goal = tick
        self._passed_s = passed.time_s

    def latch_stop(self, reason: StopReason) -> None:
        """Latch a stop for a reason; then only `pass_hold` passes. Safe from any thread."""
        self._latch.latch_stop(reason)

    def check_stop(self) -> None:
        """Check that no stop is latched.

        Raises:
            RefusedError: The arm was stopped; the error has the reason.
        """
        self._latch.raise_if_stopped()

    def acknowledge(self) -> StopReason | None:
        """Clear a stop and return its reason.

        The goals are cleared: `pass_reset` is required before the next goal.
        """
        if self._latch.reason is not None:
            for joint in self._joints:
                joint.goal = None
        return self._latch.acknowledge()

    @property
    def stop_reason(self) -> StopReason | None:
        """The reason for the stop; None if the arm is not stopped."""
        return self._latch.reason

    @property
    def goals(self) -> TickRow:
        """The last goal tick sent to each joint; None if no goal is in force."""
        return tuple([joint.goal for joint in self._joints])

    @property
    def measured_ticks(self) -> TickRow:
        """The last measured tick of each joint; None before the first measurement."""
        return tuple([joint.measured for joint in self._joints])

    def check_range(self, goals: TickRow, start: Sequence[int]) -> None:
        """Check the final goals of a motion before it begins, without sending anything.

        A joint that is outside its limits at ``start`` may stay, but not move further out.

        Raises:
            RefusedError: A joint would leave its limits.
        """
        self._require_row(goals)
        for joint, tick, at in zip(self._joints, goals, start, strict=True):
            if tick is not None:
                joint.check_range(tick, at)

    def _require_row(self, row: Sequence[float | None]) -> None:
        if len(row) != len(self._joints):
            text = f"{len(row)} values do not match the {len(self._joints)} joints of this arm."
            raise RefusedError(text, "Nothing was sent.")

    def _commanded(self, ticks: TickRow) -> list[tuple[JointGate, int]]:
        """Return the joints in a command, each with its tick."""
        self._require_row(ticks)
        rows = zip(self._joints, ticks, strict=True)
        return [(joint, tick) for joint, tick in rows if tick is not None]

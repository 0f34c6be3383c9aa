"""The gate: every goal passes it before any byte is sent; step limit and stop latch."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from types import MappingProxyType

from ikservo.clock import Clock
from ikservo.errors import RefusedError
from ikservo.guard.limits import CommandLimits, LeadLimiter, require_int_tick

__all__ = ["MAX_ELAPSED_S", "Gate", "RateLimiter", "StopKind", "StopLatch", "StopReason"]


# After a stall of the program goals may not leap by what the joint could have gone meanwhile.
MAX_ELAPSED_S = 0.05


class RateLimiter:
    """The steps of one joint's goals.

    Goals are whole ticks, so that a step may be one tick longer than the speed says; but only the
    next ones pay for it, or many small steps would be faster than the speed.

    Args:
        ticks_s: The top speed, ticks a second.
    """

    def __init__(self, ticks_s: float) -> None:
        self._ticks_s = ticks_s
        self._spare = 1.0

    def max_step(self, elapsed_s: float) -> int:
        """Return the longest step for the time since the last one, ticks."""
        return math.floor(self._remaining_step(elapsed_s) + 1e-6)

    def consume(self, step: int, elapsed_s: float) -> None:
        """Note a step that was taken."""
        self._spare = min(self._remaining_step(elapsed_s) - step, 1.0)

    def _remaining_step(self, elapsed_s: float) -> float:
        return self._spare + self._ticks_s * min(max(elapsed_s, 0.0), MAX_ELAPSED_S)


class StopKind(Enum):
    """Why an arm was stopped, for programs: control flow looks at nothing else."""

    CTRL_C = auto()
    """SIGINT, or ``KeyboardInterrupt`` in a callback."""
    TERMINATED = auto()
    """SIGTERM."""
    HANGUP = auto()
    """SIGHUP: the terminal was closed."""
    PROGRAM = auto()
    """``Arm.stop`` of the program that moves the arm."""
    CANCELLED = auto()
    """``Motion.cancel``."""
    CLIENT = auto()
    """Another terminal, or the page."""
    CLOSED = auto()
    """The arm, or what moves it, was closed during a motion."""
    RELEASED = auto()
    """Torque was switched off."""
    UNPLUGGED = auto()
    """The line was lost."""
    FAULT = auto()
    """An error ended the motion."""


@dataclass(frozen=True, slots=True)
class StopReason:
    """Why an arm was stopped.

    Attributes:
        kind: For programs.
        text: For the user; lines after the first are details.
    """

    kind: StopKind
    text: str = ""

    @property
    def headline(self) -> str:
        """The first line of the text."""
        return self.text.splitlines()[0] if self.text else "no reason was given"


class StopLatch:
    """Remembers why the arm was stopped, until somebody acknowledges it.

    To latch a stop is one assignment, so that a signal or another thread may do it at any time.
    """

    def __init__(self) -> None:
        self._reason: StopReason | None = None

    @property
    def reason(self) -> StopReason | None:
        """Why the arm was stopped; None where it is not."""
        return self._reason

    def latch_stop(self, reason: StopReason) -> None:
        """Stop for a reason; the first one stays, for it is the cause of the others."""
        self._reason = self._reason or reason

    def acknowledge(self) -> StopReason | None:
        """Let the arm be moved again, and return what it was stopped for."""
        reason, self._reason = self._reason, None
        return reason

    def raise_if_stopped(self) -> None:
        """Raise while the stop stays.

        Raises:
            RefusedError: The arm was stopped; says why.
        """
        if self._reason is not None:
            raise RefusedError(
                f"The arm was stopped: {self._reason.headline}",
                "Check the arm, then acknowledge the stop.",
            )


class Gate:
    """Passes whole commands on to the servos, or refuses them whole.

    A command is a goal tick for each of some joints. It passes when every joint is known, every
    goal is inside the joint's limits, none moves faster than its fence allows, and none leads the
    measured joint by more than its look-ahead. Where a joint stands outside its limits it may be
    walked back, never further out. Once `latch_stop` was called only `hold` passes, until somebody
    calls `acknowledge` and `reset_goals`.

    Args:
        fences: One for each joint.
        send: Writes goal ticks by servo id; called only with what has passed.
        clock: Tells how long the last command is ago.
    """

    def __init__(
        self,
        fences: Sequence[CommandLimits],
        send: Callable[[Mapping[int, int]], None],
        clock: Clock,
    ) -> None:
        self._fences = {fence.joint: fence for fence in fences}
        self._ranges = {fence.joint: fence.tick_range for fence in fences}
        self._strides = {fence.joint: RateLimiter(fence.max_ticks_s) for fence in fences}
        self._send, self._clock = send, clock
        self._ahead, self._latch = LeadLimiter(fences), StopLatch()
        self._goals: dict[str, int] = {}
        self._passed_s = clock.now_s()

    def reset_goals(self, ticks: Mapping[str, int]) -> None:
        """Take the measured ticks of the joints as where goals start from, and send them.

        This is what makes torque safe to switch on: the servos' goals are where they are.

        Raises:
            RefusedError: A joint is unknown, a tick is no whole number, or the arm was stopped.
        """
        self._latch.raise_if_stopped()
        for joint, tick in ticks.items():
            self._limits_of(joint)
            require_int_tick(joint, tick)
        self._commit_goals(ticks, self._clock.now_s())

    def update_measured(self, ticks: Mapping[str, int], time_s: float) -> None:
        """Take where joints were measured; those that did not answer are left out.

        Goals must stay within the look-ahead of what was seen, and what was seen must be fresh.

        Args:
            ticks: Measured tick by joint.
            time_s: When, in the time of the gate's clock.

        Raises:
            RefusedError: A joint is unknown, a tick no whole number, or the time no number.
        """
        for joint in ticks:
            self._limits_of(joint)
        self._ahead.update_measured(ticks, time_s)

    def set_speeds(self, speeds: Mapping[str, float]) -> None:
        """Take the top speeds of the motion that begins, rad/s or m/s: slow ones lead less.

        A joint that is left out runs at the speed of its fence.

        Raises:
            RefusedError: A joint is unknown, or a speed not above zero.
        """
        for joint in speeds:
            self._limits_of(joint)
        self._ahead.set_speeds(speeds)

    def allowed_advance_s(self, elapsed_s: float) -> float:
        """Return by how much a motion may go on in a time: less where a joint lags behind.

        A stream that adds this to its motion's time, in place of the time itself, keeps inside
        the look-ahead: it waits for the joints.
        """
        return self._ahead.allowed_advance_s(self._goals, min(elapsed_s, MAX_ELAPSED_S))

    def stale_joints(self, now_s: float) -> tuple[str, ...]:
        """Return the joints whose last position reading is too old for a goal to pass."""
        return self._ahead.stale_joints(now_s)

    def shorten_goals(self, goals: Mapping[str, int], now_s: float) -> dict[str, int]:
        """Return the goals nearest to the given ones, on the straight way to them, that may pass.

        Steps that are too long for the time since the last command, or for the look-ahead, are
        cut, all joints by the same share. A goal that the joint could not reach within 50 ms at
        its top speed is no late step but a jump: it stays as it is, and `send` refuses it.

        Args:
            goals: Wanted tick by joint.
            now_s: The time that is then given to `send`.

        Raises:
            RefusedError: A joint is unknown or would leave its limits, a tick is no whole number,
                or the joint was not measured lately.
        """
        if not goals:
            return {}
        share = min(self._step_fraction(joint, tick, now_s) for joint, tick in goals.items())
        return {j: self._goals[j] + int(share * (t - self._goals[j])) for j, t in goals.items()}

    def send(self, goals: Mapping[str, int], now_s: float | None = None) -> None:
        """Pass goal ticks by joint on to the servos.

        Args:
            goals: Goal tick by joint.
            now_s: The reading of the gate's clock by which the goals were worked out, so that the
                steps are judged by the same time; the clock is read here if None.

        Raises:
            RefusedError: One of the goals may not pass, or the reading is not between the last
                command and now; nothing was sent for any joint.
        """
        self._latch.raise_if_stopped()
        now_s = self._command_time_s(now_s)
        elapsed_s = now_s - self._passed_s
        for joint, tick in goals.items():
            self._check_goal(joint, tick, elapsed_s)
            self._ahead.check_lead(joint, tick, self._goals[joint], now_s)
        for joint, tick in goals.items():
            self._strides[joint].consume(abs(tick - self._goals[joint]), elapsed_s)
        self._commit_goals(goals, now_s)

    def hold(self, ticks: Mapping[str, int]) -> None:
        """Let joints stay where they are, also while the arm is stopped.

        Args:
            ticks: A goal by joint: the one that stands, the joint's measured place, or between.
                One outside the limits is brought to them.

        Raises:
            RefusedError: A goal would move a joint; nothing was sent for any.
        """
        inside = {joint: self.clamp(joint, tick) for joint, tick in ticks.items()}
        for joint, tick in inside.items():
            self._check_hold_goal(joint, tick)
        self._commit_goals(inside, self._clock.now_s())

    def latch_stop(self, reason: StopReason) -> None:
        """Stop for a reason: from now on nothing but `hold` passes. Safe from any thread."""
        self._latch.latch_stop(reason)

    def check_stop(self) -> None:
        """Raise while a stop was not acknowledged.

        Raises:
            RefusedError: The arm was stopped; says why.
        """
        self._latch.raise_if_stopped()

    def acknowledge(self) -> StopReason | None:
        """End a stop and return its reason; goals start anew from where the joints are measured.

        What stood before is forgotten: `reset_goals` comes before the next goal.
        """
        if self._latch.reason is not None:
            self._goals.clear()
        return self._latch.acknowledge()

    @property
    def stop_reason(self) -> StopReason | None:
        """Why the arm was stopped; None where it is not."""
        return self._latch.reason

    @property
    def goals(self) -> Mapping[str, int]:
        """Return the goal tick of each joint that last passed."""
        return MappingProxyType(self._goals)

    @property
    def measured_ticks(self) -> Mapping[str, int]:
        """Return the tick at which each joint was last measured."""
        return self._ahead.measured_ticks

    def check_range(self, goals: Mapping[str, int], start: Mapping[str, int]) -> None:
        """Check distant goals before a motion to them starts; sends nothing.

        Args:
            goals: Where joints shall end, ticks.
            start: Where they are; a joint outside its limits may stay, not go further out.

        Raises:
            RefusedError: A joint is unknown or would leave its limits.
        """
        for joint, tick in goals.items():
            self._check_range(joint, tick, start[joint])

    def clamp(self, joint: str, tick: int) -> int:
        """Return the tick nearest to ``tick`` that the joint's range lets pass.

        Raises:
            RefusedError: The joint is unknown or was never enabled, or the tick no whole number.
        """
        require_int_tick(joint, tick)
        low, high = self._allowed_range(joint, self._last_goal(joint))
        return min(max(tick, low), high)

    def _command_time_s(self, given_s: float | None) -> float:
        """Return the time by which a command is judged."""
        now_s = self._clock.now_s()
        if given_s is None:
            return now_s
        # Each second is given to one step only. Written so that no number at all is refused, too.
        if not self._passed_s <= given_s <= now_s:
            raise RefusedError(
                f"The time of the goals is {given_s} s, not between that of the last command, "
                f"{self._passed_s} s, and now, {now_s} s.",
                "Nothing was sent.",
            )
        return given_s

    def _step_fraction(self, joint: str, tick: int, now_s: float) -> float:
        """Return how much of a joint's step may pass, 0 to 1; 1 for what `send` must judge."""
        last, stride = self._last_goal(joint), self._strides[joint]
        self._check_range(joint, tick, last)
        step = abs(tick - last)
        if not 0 < step <= stride.max_step(MAX_ELAPSED_S):
            return 1.0
        room = self._ahead.remaining_lead(joint, last, (tick - last) // step, now_s)
        return min(stride.max_step(now_s - self._passed_s), room, step) / step

    def _check_goal(self, joint: str, tick: int, elapsed_s: float) -> None:
        last = self._last_goal(joint)
        self._check_range(joint, tick, last)
        step, most = abs(tick - last), self._strides[joint].max_step(elapsed_s)
        if step > most:
            shown_ms = min(elapsed_s, MAX_ELAPSED_S) * 1e3
            raise RefusedError(
                f"Velocity limit: setpoint step of {step} ticks in {shown_ms:.0f} ms for {joint} "
                f"(max {most}); stopped.",
                "Setpoints must not move faster than the fastest speed of the arm file.",
            )

    def _check_hold_goal(self, joint: str, tick: int) -> None:
        last = self._last_goal(joint)
        seen = self._ahead.measured_ticks.get(joint, last)
        if not min(last, seen) <= tick <= max(last, seen):
            raise RefusedError(
                f"Setpoint {tick} would move {joint}, which has to stay between tick {seen} "
                f"and its setpoint {last}.",
                "Nothing was sent.",
            )

    def _check_range(self, joint: str, tick: int, last: int) -> None:
        fence = self._limits_of(joint)
        require_int_tick(joint, tick)
        low, high = self._allowed_range(joint, last)
        if not low <= tick <= high:
            raise RefusedError(fence.describe_violation(tick), "Choose a target inside the limits.")

    def _allowed_range(self, joint: str, last: int) -> tuple[int, int]:
        """Return the ticks that may pass: the limits, and the way back to them from outside."""
        low, high = self._ranges[joint]
        return min(low, last), max(high, last)

    def _last_goal(self, joint: str) -> int:
        self._limits_of(joint)
        if joint not in self._goals:
            raise RefusedError(
                f"The position of {joint} has not been measured.", "Switch its torque on first."
            )
        return self._goals[joint]

    def _limits_of(self, joint: str) -> CommandLimits:
        if joint not in self._fences:
            raise RefusedError(f"There is no joint {joint!r} on this arm.", "Nothing was sent.")
        return self._fences[joint]

    def _commit_goals(self, goals: Mapping[str, int], now_s: float) -> None:
        self._send({self._fences[joint].servo_id: tick for joint, tick in goals.items()})
        self._goals.update(goals)
        self._passed_s = now_s

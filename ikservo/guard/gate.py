"""The gate: every goal passes it before any byte is sent; step limit and stop latch."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum, auto
from types import MappingProxyType

from ikservo.clock import Clock
from ikservo.errors import LatchedStopError, RefusedError
from ikservo.guard.driven_joint import DrivenJoint, require_int_tick
from ikservo.guard.joint_gate import MAX_ELAPSED_S, JointGate


class StopKind(Enum):
    """Kind of reason why an arm was stopped; control flow depends only on this."""

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
    """Another terminal, or the web page."""
    CLOSED = auto()
    """The arm, or the motion's owner, was closed during a motion."""
    RELEASED = auto()
    """Torque was switched off."""
    UNPLUGGED = auto()
    """The port was lost."""
    OBSTACLE = auto()
    """Something came into the path of a motion."""
    FAULT = auto()
    """An error ended the motion."""


@dataclass(frozen=True, slots=True)
class StopReason:
    """Reason why an arm was stopped.

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
    """Holds the reason of a stop until it is acknowledged.

    Latching a stop is one assignment, so that a signal or another thread may do it at any time.
    """

    def __init__(self) -> None:
        self._reason: StopReason | None = None

    @property
    def reason(self) -> StopReason | None:
        """Reason of the stop; None if the arm is not stopped."""
        return self._reason

    def latch_stop(self, reason: StopReason) -> None:
        """Stop for a reason; the first reason is kept, because it causes the others."""
        self._reason = self._reason or reason

    def acknowledge(self) -> StopReason | None:
        """Clear the stop and return its reason."""
        reason, self._reason = self._reason, None
        return reason

    def raise_if_stopped(self) -> None:
        """Raise if a stop is latched.

        Raises:
            LatchedStopError: The arm was stopped; the reason is named.
        """
        if self._reason is not None:
            raise LatchedStopError(self._reason.headline)


class Gate:
    """Sends commands to the servos that pass all checks, or refuses them as a whole.

    A command is a goal tick for each of some joints. It passes if every joint is known, every goal
    is inside the joint's limits, none moves faster than its limit, and none leads the measured
    joint by more than its maximum lead. A joint outside its limits may be moved back,
    never further out. After `latch_stop` only `hold` passes, until `acknowledge` and
    `reset_goals` are called.

    Args:
        limits: One per joint.
        write_goals: Writes goal ticks by servo id, as ``StreamedServos`` does through
            ``hardware/goal_writing.py``; called only with goals that passed.
        clock: Measures the time since the last command.
    """

    def __init__(
        self,
        limits: Sequence[DrivenJoint],
        write_goals: Callable[[Mapping[int, int]], None],
        clock: Clock,
    ) -> None:
        self._joints = {driven.joint: JointGate(driven) for driven in limits}
        self._write_goals, self._clock = write_goals, clock
        self._latch = StopLatch()
        self._passed_s = clock.now_s()

    def reset_goals(self, ticks: Mapping[str, int]) -> None:
        """Send the measured ticks of the joints as goals, from which later goals start.

        Afterwards torque can be enabled safely: the servos' goals are their positions.

        Raises:
            RefusedError: A joint is unknown, a tick is not an integer, or the arm was stopped.
        """
        self._latch.raise_if_stopped()
        self._require_known(ticks)
        for name, tick in ticks.items():
            require_int_tick(name, tick)
        self._commit_goals(ticks, self._clock.now_s())

    def update_measured(self, ticks: Mapping[str, int], time_s: float) -> None:
        """Update the measured positions; joints without a reply are left out.

        Goals must stay within the maximum lead of recent measurements.

        Args:
            ticks: Measured tick by joint.
            time_s: Time of the measurement, by the gate's clock.

        Raises:
            RefusedError: A joint is unknown, a tick not an integer, or the time not finite.
        """
        if not math.isfinite(time_s):
            raise RefusedError(f"The time of a measurement is {time_s} s.", "It was ignored.")
        self._require_known(ticks)
        for name, tick in ticks.items():
            require_int_tick(name, tick)
        for name, tick in ticks.items():
            self._joints[name].update_measured(tick, time_s)

    def set_speeds(self, speeds: Mapping[str, float]) -> None:
        """Set the maximum speeds of the next motion, rad/s or m/s; slower joints get less lead.

        A joint that is left out has the speed of its limits.

        Raises:
            RefusedError: A joint is unknown, or a speed not above zero.
        """
        self._require_known(speeds)
        for name, speed in speeds.items():
            if not speed > 0.0:
                raise RefusedError(
                    f"The speed of {name} must be above zero, not {speed} rad/s.",
                    "Nothing was sent.",
                )
        for name, joint in self._joints.items():
            joint.set_speed(speeds.get(name, joint.driven.speed))

    def allowed_advance_s(self, elapsed_s: float) -> float:
        """Return how far a motion may advance in a time; less if a joint lags behind.

        A stream that advances its motion by this instead of the time itself keeps within the
        maximum lead: it waits for the joints.
        """
        elapsed_s = min(elapsed_s, MAX_ELAPSED_S)
        driven = [joint for joint in self._joints.values() if joint.goal is not None]
        return min([joint.allowed_advance_s(elapsed_s) for joint in driven], default=elapsed_s)

    def eases(self) -> list[float]:
        """Return the rate at which the goals of each joint may advance, 0 to 1; less if it lags."""
        return [joint.ease() for joint in self._joints.values()]

    def stale_joints(self, now_s: float) -> tuple[str, ...]:
        """Return the joints whose last position reading is too old for a goal to pass."""
        return tuple([name for name, joint in self._joints.items() if joint.is_stale(now_s)])

    def shorten_goals(self, goals: Mapping[str, int], now_s: float) -> dict[str, int]:
        """Return the allowed goals nearest to the given ones, on the straight path to them.

        Steps that are too long for the time since the last command, or for the maximum lead, are
        reduced, all joints by the same fraction. A goal that the joint could not reach within 50 ms
        at full speed is not a late step but a jump: it is returned unchanged; `send` refuses it.

        Args:
            goals: Desired tick by joint.
            now_s: The time that is then passed to `send`.

        Raises:
            RefusedError: A joint is unknown or would leave its limits, a tick is not an integer,
                or the joint was not measured recently.
        """
        self._require_known(goals)
        fraction, shortened, elapsed_s = 1.0, dict[str, int](), now_s - self._passed_s
        for name, tick in goals.items():
            fraction = min(fraction, self._joints[name].step_fraction(tick, elapsed_s, now_s))
        for name, tick in goals.items():
            last = self._joints[name].last_goal()
            shortened[name] = last + int(fraction * (tick - last))
        return shortened

    def send(self, goals: Mapping[str, int], now_s: float | None = None) -> None:
        """Send goal ticks by joint to the servos.

        Args:
            goals: Goal tick by joint.
            now_s: The time by the gate's clock for which the goals were computed, so that the
                steps are checked for the same time; None reads the clock.

        Raises:
            RefusedError: One of the goals is not allowed, or the time is not between the last
                command and now; nothing was sent for any joint.
        """
        self._latch.raise_if_stopped()
        now_s = self._command_time_s(now_s)
        elapsed_s = now_s - self._passed_s
        self._require_known(goals)
        for name, tick in goals.items():
            self._joints[name].check_goal(tick, elapsed_s, now_s)
        for name, tick in goals.items():
            self._joints[name].consume_step(tick, elapsed_s)
        self._commit_goals(goals, now_s)

    def hold(self, ticks: Mapping[str, int]) -> None:
        """Let joints hold their positions, also while the arm is stopped.

        Args:
            ticks: A goal by joint: the present goal, the measured position, or a tick between. A
                tick outside the limits is clamped to them.

        Raises:
            RefusedError: A goal would move a joint; nothing was sent for any.
        """
        inside = {name: self.clamp(name, tick) for name, tick in ticks.items()}
        for name, tick in inside.items():
            self._joints[name].check_hold_goal(tick)
        self._commit_goals(inside, self._clock.now_s())

    def latch_stop(self, reason: StopReason) -> None:
        """Stop for a reason: from now on only `hold` passes. Safe from any thread."""
        self._latch.latch_stop(reason)

    def check_stop(self) -> None:
        """Raise if a stop is not acknowledged.

        Raises:
            RefusedError: The arm was stopped; the reason is named.
        """
        self._latch.raise_if_stopped()

    def acknowledge(self) -> StopReason | None:
        """Clear a stop and return its reason.

        The goals are cleared: `reset_goals` is required before the next goal.
        """
        if self._latch.reason is not None:
            for joint in self._joints.values():
                joint.goal = None
        return self._latch.acknowledge()

    @property
    def stop_reason(self) -> StopReason | None:
        """Reason of the stop; None if the arm is not stopped."""
        return self._latch.reason

    @property
    def goals(self) -> Mapping[str, int]:
        """The goal tick of each joint that was last sent."""
        goals = [(name, joint.goal) for name, joint in self._joints.items()]
        return MappingProxyType({name: goal for name, goal in goals if goal is not None})

    @property
    def measured_ticks(self) -> Mapping[str, int]:
        """The last measured tick of each joint."""
        measured = [(name, joint.measured) for name, joint in self._joints.items()]
        return MappingProxyType({name: tick for name, tick in measured if tick is not None})

    def check_range(self, goals: Mapping[str, int], start: Mapping[str, int]) -> None:
        """Check distant goals before a motion to them; sends nothing.

        Args:
            goals: The final goals, ticks.
            start: The present ticks; a joint outside its limits may stay, but not move further out.

        Raises:
            RefusedError: A joint is unknown or would leave its limits.
        """
        self._require_known(goals)
        for name, tick in goals.items():
            self._joints[name].check_range(tick, start[name])

    def clamp(self, name: str, tick: int) -> int:
        """Return the tick nearest to ``tick`` inside the joint's allowed range.

        Raises:
            RefusedError: The joint is unknown or was never enabled, or the tick is not an integer.
        """
        self._require_known([name])
        return self._joints[name].clamp(tick)

    def _require_known(self, names: Iterable[str]) -> None:
        for name in names:
            if name not in self._joints:
                raise RefusedError(f"There is no joint {name!r} on this arm.", "Nothing was sent.")

    def _command_time_s(self, given_s: float | None) -> float:
        """Compute the time for which a command is checked."""
        now_s = self._clock.now_s()
        if given_s is None:
            return now_s
        # Each second is used by only one step. This form of the comparison also refuses NaN.
        if not self._passed_s <= given_s <= now_s:
            raise RefusedError(
                f"The time of the goals is {given_s} s, not between that of the last command, "
                f"{self._passed_s} s, and now, {now_s} s.",
                "Nothing was sent.",
            )
        return given_s

    def _commit_goals(self, goals: Mapping[str, int], now_s: float) -> None:
        self._write_goals(
            {self._joints[name].driven.servo_id: tick for name, tick in goals.items()}
        )
        for name, tick in goals.items():
            self._joints[name].goal = tick
        self._passed_s = now_s

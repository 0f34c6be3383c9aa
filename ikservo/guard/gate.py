"""The gate before the bytes: no goal position reaches a bus by another way."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

from ikservo.clock import Clock
from ikservo.errors import RefusedError
from ikservo.guard.fence import Fence
from ikservo.guard.latch import Latch
from ikservo.guard.look_ahead import LookAhead
from ikservo.guard.stride import LONGEST_ELAPSED_S, Stride
from ikservo.guard.whole import check_whole

__all__ = ["Gate"]


class Gate:
    """Passes whole commands on to the servos, or refuses them whole.

    A command is a goal tick for each of some joints. It passes when every joint is known, every
    goal is inside the joint's limits, none moves faster than its fence allows, and none leads the
    measured joint by more than its look-ahead. Where a joint stands outside its limits it may be
    walked back, never further out. Once `trip` was called only `hold` passes, until somebody
    calls `acknowledge` and `start_from`.

    Args:
        fences: One for each joint.
        send: Writes goal ticks by servo id; called only with what has passed.
        clock: Tells how long the last command is ago.
    """

    def __init__(
        self, fences: Sequence[Fence], send: Callable[[Mapping[int, int]], None], clock: Clock
    ) -> None:
        self._fences = {fence.joint: fence for fence in fences}
        self._ranges = {fence.joint: fence.ticks for fence in fences}
        self._strides = {fence.joint: Stride(fence.ticks_s) for fence in fences}
        self._send, self._clock = send, clock
        self._ahead, self._latch = LookAhead(fences), Latch()
        self._goals: dict[str, int] = {}
        self._passed_s = clock.now_s()

    def start_from(self, ticks: Mapping[str, int]) -> None:
        """Take the measured ticks of the joints as where goals start from, and send them.

        This is what makes torque safe to switch on: the servos' goals are where they are.

        Raises:
            RefusedError: A joint is unknown, a tick is no whole number, or the arm was stopped.
        """
        self._latch.check()
        for joint, tick in ticks.items():
            self._fence(joint)
            check_whole(joint, tick)
        self._commit(ticks, self._clock.now_s())

    def see(self, ticks: Mapping[str, int], time_s: float) -> None:
        """Take where joints were measured; those that did not answer are left out.

        Goals must stay within the look-ahead of what was seen, and what was seen must be fresh.

        Args:
            ticks: Measured tick by joint.
            time_s: When, in the time of the gate's clock.

        Raises:
            RefusedError: A joint is unknown, a tick no whole number, or the time no number.
        """
        for joint in ticks:
            self._fence(joint)
        self._ahead.see(ticks, time_s)

    def run_at(self, speeds: Mapping[str, float]) -> None:
        """Take the top speeds of the motion that begins, rad/s or m/s: slow ones lead less.

        A joint that is left out runs at the speed of its fence.

        Raises:
            RefusedError: A joint is unknown, or a speed not above zero.
        """
        for joint in speeds:
            self._fence(joint)
        self._ahead.run_at(speeds)

    def advance_s(self, elapsed_s: float) -> float:
        """Return by how much a motion may go on in a time: less where a joint lags behind.

        A stream that adds this to its motion's time, in place of the time itself, keeps inside
        the look-ahead: it waits for the joints.
        """
        return self._ahead.advance_s(self._goals, min(elapsed_s, LONGEST_ELAPSED_S))

    def send(self, goals: Mapping[str, int]) -> None:
        """Pass goal ticks by joint on to the servos.

        Raises:
            RefusedError: One of the goals may not pass; nothing was sent for any joint.
        """
        self._latch.check()
        now_s = self._clock.now_s()
        elapsed_s = now_s - self._passed_s
        for joint, tick in goals.items():
            self._check(joint, tick, elapsed_s)
            self._ahead.check(joint, tick, self._goals[joint], now_s)
        for joint, tick in goals.items():
            self._strides[joint].take(abs(tick - self._goals[joint]), elapsed_s)
        self._commit(goals, now_s)

    def hold(self, ticks: Mapping[str, int]) -> None:
        """Let joints stay where they are, also while the arm is stopped.

        Args:
            ticks: A goal by joint: the one that stands, the joint's measured place, or between.
                One outside the limits is brought to them.

        Raises:
            RefusedError: A goal would move a joint; nothing was sent for any.
        """
        inside = {joint: self.nearest(joint, tick) for joint, tick in ticks.items()}
        for joint, tick in inside.items():
            self._check_stays(joint, tick)
        self._commit(inside, self._clock.now_s())

    def trip(self, reason: str) -> None:
        """Stop for a reason: from now on nothing but `hold` passes. Safe from any thread."""
        self._latch.trip(reason)

    def acknowledge(self) -> str:
        """End a stop and return its reason; goals start anew from where the joints are measured.

        What stood before is forgotten: `start_from` comes before the next goal.
        """
        if self._latch.reason:
            self._goals.clear()
        return self._latch.acknowledge()

    @property
    def tripped(self) -> str:
        """Return why the arm was stopped; empty where it is not."""
        return self._latch.reason

    @property
    def goals(self) -> Mapping[str, int]:
        """Return the goal tick of each joint that last passed."""
        return MappingProxyType(self._goals)

    @property
    def seen(self) -> Mapping[str, int]:
        """Return the tick at which each joint was last measured."""
        return self._ahead.seen

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

    def nearest(self, joint: str, tick: int) -> int:
        """Return the tick nearest to ``tick`` that the joint's range lets pass.

        Raises:
            RefusedError: The joint is unknown or was never enabled, or the tick no whole number.
        """
        check_whole(joint, tick)
        low, high = self._range(joint, self._last(joint))
        return min(max(tick, low), high)

    def _check(self, joint: str, tick: int, elapsed_s: float) -> None:
        last = self._last(joint)
        self._check_range(joint, tick, last)
        step, most = abs(tick - last), self._strides[joint].most(elapsed_s)
        if step > most:
            shown_ms = min(elapsed_s, LONGEST_ELAPSED_S) * 1e3
            raise RefusedError(
                f"{joint} would have to jump {step} ticks in {shown_ms:.0f} ms, more than {most}.",
                "Nothing was sent. Goals must move no faster than the arm file's fastest speed.",
            )

    def _check_stays(self, joint: str, tick: int) -> None:
        last = self._last(joint)
        seen = self._ahead.seen.get(joint, last)
        if not min(last, seen) <= tick <= max(last, seen):
            raise RefusedError(
                f"{joint} stands between {seen} and its goal {last}; {tick} would move it.",
                "Nothing was sent.",
            )

    def _check_range(self, joint: str, tick: int, last: int) -> None:
        fence = self._fence(joint)
        check_whole(joint, tick)
        low, high = self._range(joint, last)
        if not low <= tick <= high:
            raise RefusedError(fence.beyond(tick), "Nothing was sent. Choose a nearer goal.")

    def _range(self, joint: str, last: int) -> tuple[int, int]:
        """Return the ticks that may pass: the limits, and the way back to them from outside."""
        low, high = self._ranges[joint]
        return min(low, last), max(high, last)

    def _last(self, joint: str) -> int:
        self._fence(joint)
        if joint not in self._goals:
            raise RefusedError(
                f"Nobody has measured where {joint} is.", "Switch its torque on first."
            )
        return self._goals[joint]

    def _fence(self, joint: str) -> Fence:
        if joint not in self._fences:
            raise RefusedError(f"The guard knows no joint {joint!r}.", "Nothing was sent.")
        return self._fences[joint]

    def _commit(self, goals: Mapping[str, int], now_s: float) -> None:
        self._send({self._fences[joint].servo_id: tick for joint, tick in goals.items()})
        self._goals.update(goals)
        self._passed_s = now_s

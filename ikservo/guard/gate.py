"""The gate before the bytes: no goal position reaches a bus by another way."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from types import MappingProxyType

from ikservo.clock import Clock
from ikservo.errors import RefusedError
from ikservo.guard.fence import Fence

__all__ = ["Gate"]

# After a stall of the program goals may not leap by what the joint could have gone meanwhile.
_LONGEST_ELAPSED_S = 0.05


class Gate:
    """Passes whole commands on to the servos, or refuses them whole.

    A command is a goal tick for each of some joints. It passes when every joint is known, every
    goal is inside the joint's limits, and none moves faster than its fence allows. Where a joint
    stands outside its limits it may be walked back, never further out.

    Args:
        fences: One for each joint.
        send: Writes goal ticks by servo id; called only with what has passed.
        clock: Tells how long the last command is ago.
    """

    def __init__(
        self, fences: Sequence[Fence], send: Callable[[Mapping[int, int]], None], clock: Clock
    ) -> None:
        self._fences = {fence.joint: fence for fence in fences}
        self._send, self._clock = send, clock
        self._goals: dict[str, int] = {}
        self._passed_s = 0.0

    def start_from(self, ticks: Mapping[str, int]) -> None:
        """Take the measured ticks of the joints as where goals start from, and send them.

        This is what makes torque safe to switch on: the servos' goals are where they are.

        Raises:
            RefusedError: A joint is unknown or a tick is no whole number.
        """
        for joint, tick in ticks.items():
            self._fence(joint)
            _check_whole(joint, tick)
        self._commit(ticks, self._clock.now_s())

    def send(self, goals: Mapping[str, int]) -> None:
        """Pass goal ticks by joint on to the servos.

        Raises:
            RefusedError: One of the goals may not pass; nothing was sent for any joint.
        """
        now_s = self._clock.now_s()
        elapsed_s = min(now_s - self._passed_s, _LONGEST_ELAPSED_S)
        for joint, tick in goals.items():
            self._check(self._fence(joint), tick, elapsed_s)
        self._commit(goals, now_s)

    @property
    def goals(self) -> Mapping[str, int]:
        """Return the goal tick of each joint that last passed."""
        return MappingProxyType(self._goals)

    def check_range(self, goals: Mapping[str, int], start: Mapping[str, int]) -> None:
        """Check distant goals before a motion to them starts; sends nothing.

        Args:
            goals: Where joints shall end, ticks.
            start: Where they are; a joint outside its limits may stay, not go further out.

        Raises:
            RefusedError: A joint is unknown or would leave its limits.
        """
        for joint, tick in goals.items():
            _check_range(self._fence(joint), tick, start[joint])

    def nearest(self, joint: str, tick: int) -> int:
        """Return the tick nearest to ``tick`` that the joint's range lets pass."""
        low, high = _range(self._fence(joint), self._last(joint))
        return min(max(tick, low), high)

    def _check(self, fence: Fence, tick: int, elapsed_s: float) -> None:
        last = self._last(fence.joint)
        _check_range(fence, tick, last)
        step = abs(tick - last)
        if step > fence.step_ticks(elapsed_s):
            raise RefusedError(
                f"{fence.joint} would have to jump {step} ticks in {elapsed_s * 1000:.0f} ms, "
                f"more than {fence.step_ticks(elapsed_s)}.",
                "Nothing was sent. Goals must move no faster than the arm file's fastest speed.",
            )

    def _last(self, joint: str) -> int:
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


def _check_range(fence: Fence, tick: int, last: int) -> None:
    _check_whole(fence.joint, tick)
    low, high = _range(fence, last)
    if not low <= tick <= high:
        raise RefusedError(fence.beyond(tick), "Nothing was sent. Choose a nearer goal.")


def _range(fence: Fence, last: int) -> tuple[int, int]:
    """Return the ticks that may pass: the limits, and the way back to them from outside."""
    low, high = fence.ticks
    return min(low, last), max(high, last)


def _check_whole(joint: str, tick: object) -> None:
    # bool is an int in Python, and True is no place to drive a joint to.
    if not isinstance(tick, int) or isinstance(tick, bool):
        raise RefusedError(f"The goal of {joint} is {tick!r}.", "Expected a whole number of ticks.")

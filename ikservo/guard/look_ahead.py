"""How far goals may be ahead of the joints, so that a dead program leaves little motion."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from ikservo.errors import RefusedError
from ikservo.guard.fence import Fence
from ikservo.guard.whole import check_whole

__all__ = ["LookAhead"]

# Older than this nobody knows where a joint is.
_STALE_S = 0.25
# From this share of the look-ahead on a motion goes slower, so that it need not stop at its end.
_EASE_FROM = 0.75


class LookAhead:
    """Keeps goals near where the joints were last seen.

    A goal further ahead than `Fence.lead_ticks` is refused, unless it is the one that stands
    already or on the way back from it; and so is one for a joint that was not seen lately.

    Args:
        fences: One for each joint.
    """

    def __init__(self, fences: Sequence[Fence]) -> None:
        self._fences = {fence.joint: fence for fence in fences}
        self._seen: dict[str, tuple[int, float]] = {}
        self.run_at({})

    @property
    def seen(self) -> dict[str, int]:
        """Return the tick at which each joint was last seen."""
        return {joint: tick for joint, (tick, _) in self._seen.items()}

    def run_at(self, speeds: Mapping[str, float]) -> None:
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
        self._leads = {j: f.lead_ticks(wanted[j]) for j, f in self._fences.items()}
        self._ticks_s = {
            j: min(wanted[j] / f.joint_map.unit_per_tick, f.ticks_s)
            for j, f in self._fences.items()
        }

    def see(self, ticks: Mapping[str, int], time_s: float) -> None:
        """Take where joints were measured at a time; those that did not answer are left out.

        Raises:
            RefusedError: A tick is no whole number, or the time no number.
        """
        if not math.isfinite(time_s):
            raise RefusedError(f"The time of a measurement is {time_s} s.", "It was ignored.")
        for joint, tick in ticks.items():
            check_whole(joint, tick)
        self._seen |= {joint: (tick, time_s) for joint, tick in ticks.items()}

    def check(self, joint: str, tick: int, last: int, now_s: float) -> None:
        """Check one goal against where the joint is.

        Args:
            joint: Its name.
            tick: The goal.
            last: The goal that stands.
            now_s: The time.

        Raises:
            RefusedError: It leads too far, or nobody has seen the joint lately.
        """
        measured, lead = self._measured(joint, now_s), self._leads[joint]
        if not min(measured - lead, last) <= tick <= max(measured + lead, last):
            raise RefusedError(
                f"Following error: the setpoint of {joint} would be {abs(tick - measured)} ticks "
                f"ahead of its position (max {lead}); stopped.",
                "Check whether something blocks the joint.",
            )

    def unseen(self, now_s: float) -> tuple[str, ...]:
        """Return the joints without a position reading of the last 0.25 s."""
        return tuple(joint for joint in self._fences if self._tick(joint, now_s) is None)

    def room(self, joint: str, last: int, direction: int, now_s: float) -> int:
        """Return how many ticks a goal may go on from ``last`` in a direction, +1 or -1.

        Raises:
            RefusedError: Nobody has seen the joint lately.
        """
        measured, lead = self._measured(joint, now_s), self._leads[joint]
        return max(lead - direction * (last - measured), 0)

    def advance_s(self, goals: Mapping[str, int], elapsed_s: float) -> float:
        """Return by how much a motion may go on in a time: less where a joint lags behind.

        Goals that move no faster than `run_at` says stay inside the look-ahead.

        Args:
            goals: The goals that stand.
            elapsed_s: The time since they were sent.
        """
        return min((self._advance_s(j, goals[j], elapsed_s) for j in goals), default=elapsed_s)

    def _advance_s(self, joint: str, goal: int, elapsed_s: float) -> float:
        if joint not in self._seen:
            return 0.0
        lead, ahead = self._leads[joint], abs(goal - self._seen[joint][0])
        ease = min((1.0 - ahead / lead) / (1.0 - _EASE_FROM), 1.0)
        # One tick is left for rounding.
        room_s = (lead - 1 - ahead) / self._ticks_s[joint]
        return max(min(ease * elapsed_s, room_s), 0.0)

    def _measured(self, joint: str, now_s: float) -> int:
        tick = self._tick(joint, now_s)
        if tick is None:
            raise RefusedError(
                f"No position reading from {joint} for {_STALE_S} s; motion stopped.",
                "Check the cable and the computer's load.",
            )
        return tick

    def _tick(self, joint: str, now_s: float) -> int | None:
        tick, seen_s = self._seen.get(joint, (0, -math.inf))
        return tick if now_s - seen_s <= _STALE_S else None

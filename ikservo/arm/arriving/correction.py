"""The last stretch of a motion: goals go on until the measured joints are where they belong."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ikservo.arm.arriving.creep import Creep
from ikservo.guard import Fence
from ikservo.kinematics.se3 import Vector
from ikservo.motion import Pace, State

__all__ = ["Correction"]

_STILL_S = 0.06
_LONGEST_S = 3.0
# A joint is short when it is further off than sensors flicker.
_SHORT_TICKS = 2


class Correction:
    """A course that begins at the arm's goals and ends when all joints have arrived and stand.

    Args:
        fences: What the servos may be told.
        goals: Where their goals are (n,), ticks.
        wanted: Where the joints shall be, ticks; None for one that keeps its goal.
        paces: How fast each may go.
    """

    def __init__(
        self,
        fences: Sequence[Fence],
        goals: Sequence[int],
        wanted: Sequence[int | None],
        paces: Sequence[Pace],
    ) -> None:
        self._joints = [
            Creep(fence, goal, tick, pace.acceleration_rad_s2 / fence.joint_map.unit_per_tick)
            for fence, goal, tick, pace in zip(fences, goals, wanted, paces, strict=True)
        ]
        self._seen_s = 0.0
        self._end_s = math.inf

    @property
    def duration_s(self) -> float:
        """Return when it ended; infinite while joints are on their way."""
        return self._end_s

    def state(self, time_s: float) -> State:
        """Return where goals are (n,) at a time from the last look at the joints on."""
        after_s = max(0.0, min(time_s, self._end_s) - self._seen_s)
        return State.rest(
            np.array([j.fence.joint_map.position(j.goal_at(after_s)) for j in self._joints])
        )

    def see(self, time_s: float, measured: Vector) -> None:
        """Take where the joints are (n,) at a time; ends the course when they have arrived."""
        for joint, position in zip(self._joints, measured, strict=True):
            tick = joint.fence.joint_map.tick(float(position))
            joint.see(tick, time_s, time_s - self._seen_s)
        self._seen_s = time_s
        settled = all(_has_ended(j) for j in self._joints) and not self.moving
        if settled or time_s >= _LONGEST_S:
            self._end_s = min(self._end_s, time_s)

    @property
    def moving(self) -> tuple[str, ...]:
        """Return the joints that have moved just now."""
        since_s = self._seen_s - _STILL_S
        return tuple(j.fence.joint for j in self._joints if j.still_since_s > since_s)

    @property
    def measured(self) -> Vector:
        """Return where the joints were last seen (n,), rad or m."""
        return np.array([j.fence.joint_map.position(j.at) for j in self._joints])

    @property
    def held(self) -> tuple[str, ...]:
        """Return the joints that did not arrive and whose goals go no further."""
        short = (j for j in self._joints if abs(j.short) >= _SHORT_TICKS)
        return tuple(j.fence.joint for j in short if j.saturation_reason is not None)

    @property
    def short(self) -> tuple[str, ...]:
        """Return which joints did not arrive, by how much and why, in words."""
        return tuple(_said(j) for j in self._joints if abs(j.short) >= _SHORT_TICKS)


def _has_ended(joint: Creep) -> bool:
    return joint.there or joint.saturation_reason is not None


def _said(joint: Creep) -> str:
    reason = joint.saturation_reason
    joint_map = joint.fence.joint_map
    missing = joint_map.say(abs(joint.short) * joint_map.unit_per_tick)
    return f"{joint_map.joint} is {missing} short: {reason.text if reason else 'timeout'}"

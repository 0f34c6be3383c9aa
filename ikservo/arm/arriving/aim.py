"""Where each joint shall be at the end of a motion, in whole ticks."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

from ikservo.arm.arriving.making_up import made_up
from ikservo.arm.arriving.whole_ticks import nearest_ticks
from ikservo.arm.planning import Plan
from ikservo.calibration import Limits
from ikservo.guard import Fence
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Vector

__all__ = ["Aim"]


class Aim:
    """What a motion is to arrive at.

    Joints of the chain that a motion of joints leaves alone belong where they stood: their goals
    lead them by what their load pulls, and that changes with the arm's posture.

    Args:
        chain: Base to tool.
        fences: What the servos may be told.
        plan: The motion.
        stood: Where the joints were before it (n,), rad or m.

    Attributes:
        ticks: Where each joint belongs; None for one besides the chain that is left alone: a
            gripper presses on.
    """

    def __init__(self, chain: Chain, fences: Sequence[Fence], plan: Plan, stood: Vector) -> None:
        self._chain, self._fences, self._target_m = chain, fences, plan.target_m
        names = [fence.joint for fence in fences]
        self._columns = [names.index(name) for name in chain.names]
        joints = zip(fences, plan.start, plan.goal, strict=True)
        self.ticks = [None if start == goal else f.tick(float(goal)) for f, start, goal in joints]
        for column in self._columns:
            if self.ticks[column] is None:
                self.ticks[column] = fences[column].tick(float(stood[column]))
        if plan.target_m is not None:
            self.ticks = self._nearest(plan.target_m, plan.goal[self._columns], ())

    def without(self, held: Collection[str], measured: Vector) -> list[int | None] | None:
        """Return where the joints belong when some can go no further, None if that is no help.

        Args:
            held: The joints that stay where they are.
            measured: Where all joints are (n,), rad or m.
        """
        if self._target_m is None or not set(held) & set(self._chain.names):
            return None
        q = made_up(self._chain, self._target_m, measured[self._columns], held)
        return None if q is None else self._nearest(self._target_m, q, held)

    def _nearest(self, target_m: Vector, q: Vector, held: Collection[str]) -> list[int | None]:
        fences = [self._fences[column] for column in self._columns]
        narrowed = [
            replace(f, limits=Limits.of(f.joint, float(x), float(x), "held"))
            if f.joint in held
            else f
            for f, x in zip(fences, q, strict=True)
        ]
        wanted = list(self.ticks)
        found = nearest_ticks(self._chain, target_m, q, narrowed)
        for column, tick in zip(self._columns, found, strict=True):
            wanted[column] = tick
        return wanted

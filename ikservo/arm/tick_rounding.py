"""Round goals to whole ticks: best tool position, compensation, approach against backlash."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from ikservo.arm.plan import MotionPlan
from ikservo.calibration import Limits
from ikservo.guard import CommandLimits
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector

__all__ = [
    "ROTATION_WEIGHT_M",
    "SettlingTarget",
    "backlash_approach",
    "compensate",
    "round_to_ticks",
]


ROTATION_WEIGHT_M = 0.01
"""Turning the tool by one radian is as bad as missing by this: 0.17 mm for a degree."""

# A joint does not leave the solver's answer by a tick for less than this.
_TICK_WEIGHT_M = 2e-6
# So many combinations are looked at in half a millisecond.
_MAX_COMBINATIONS = 20_000
_MAX_TICKS = 8
# Of these many, the best by the Jacobian, the tool's place is computed exactly.
_FINALISTS = 16


def round_to_ticks(
    chain: Chain, target_m: Vector, q: Vector, fences: Sequence[CommandLimits]
) -> tuple[int, ...]:
    """Return the whole ticks near ``q`` with the smallest error of the tool.

    Every joint's rounding moves the tool a little; a few ticks more in one joint make up for
    another's. The search is for the whole numbers d with the least ``|E - A d|²``, where A is how
    the tool moves with a tick of each joint: three rows for its position, three for its
    rotation away from the one at ``q``, these weighted by ``ROTATION_WEIGHT_M``. All combinations
    within some ticks are tried but for the joint that moves the tool most: its best tick follows
    from theirs.

    Args:
        chain: Base to tool.
        target_m: Where the tip shall be (3,), metres.
        q: The solver's answer (dof,), rad or m.
        fences: What each joint of the chain may be told, in its order.

    Returns:
        Ticks by joint, inside the limits, and never worse than the nearest ones.
    """
    start = np.array([_nearest_tick_inside(f, float(v)) for f, v in zip(fences, q, strict=True)])
    steps = _best_steps(chain, target_m, q, fences, start)
    there = _positions_at(fences, start + steps)
    turns = ROTATION_WEIGHT_M * (there - q) @ chain.jacobian(q)[3:].T
    misses = chain.forward(there)[:, :3, 3] - target_m
    costs = (
        _squared_norms(misses) + _squared_norms(turns) + _TICK_WEIGHT_M**2 * _squared_norms(steps)
    )
    return tuple(int(tick) for tick in start + steps[int(np.argmin(costs))])


def _best_steps(
    chain: Chain, target_m: Vector, q: Vector, fences: Sequence[CommandLimits], start: Vector
) -> Matrix:
    """Return the most promising steps (k, dof) from the nearest ticks, no step at all the first."""
    here = _positions_at(fences, start[None])[0]
    T, J = chain.forward_and_jacobian(here)
    weights = np.array([1.0, 1.0, 1.0, ROTATION_WEIGHT_M, ROTATION_WEIGHT_M, ROTATION_WEIGHT_M])
    A = weights[:, None] * J * _tick_units(fences, start)
    E = np.concatenate([target_m - T[:3, 3], ROTATION_WEIGHT_M * J[3:] @ (q - here)])
    low, high = (
        np.array(ends) - start for ends in zip(*(f.tick_range for f in fences), strict=True)
    )
    steps = _step_grid(A, low, high)
    lead = int(np.argmax(_squared_norms(A.T)))
    left = E - steps @ A.T
    best = np.rint(left @ A[:, lead] / (A[:, lead] @ A[:, lead]))
    steps[:, lead] = np.clip(best, low[lead], high[lead])
    left -= steps[:, lead : lead + 1] * A[:, lead]
    costs = _squared_norms(left) + _TICK_WEIGHT_M**2 * _squared_norms(steps)
    finalists = np.argsort(costs, kind="stable")[:_FINALISTS]
    return np.vstack([np.zeros(len(start)), steps[finalists]])


def _step_grid(A: Matrix, low: Vector, high: Vector) -> Matrix:
    """Return all steps (k, dof) of all joints but the one that moves the tool most."""
    order = np.argsort(-_squared_norms(A.T), kind="stable")[1:]
    axes = [np.zeros(1)] * A.shape[1]
    span, tried = _search_span(len(order))
    for joint in order[:tried].tolist():
        axes[joint] = np.arange(max(float(low[joint]), -span), min(float(high[joint]), span) + 1.0)
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)


def _search_span(joints: int) -> tuple[int, int]:
    """Return how many ticks to each side are tried, and in how many of so many joints."""
    for tried in range(joints, 0, -1):
        for span in range(_MAX_TICKS, 0, -1):
            if (2 * span + 1) ** tried <= _MAX_COMBINATIONS:
                return span, tried
    return 0, 0


def _nearest_tick_inside(fence: CommandLimits, position: float) -> int:
    low, high = fence.tick_range
    return min(max(fence.tick(position), low), high)


def _tick_units(fences: Sequence[CommandLimits], ticks: Vector) -> Vector:
    """Return what one tick more does to each joint there (dof,), rad or m, signed."""
    return np.array(
        [
            f.joint_map.position(t + 0.5) - f.joint_map.position(t - 0.5)
            for f, t in zip(fences, ticks.tolist(), strict=True)
        ]
    )


def _positions_at(fences: Sequence[CommandLimits], ticks: Matrix) -> Matrix:
    """Return the joints (k, dof) at ticks (k, dof)."""
    return np.array(
        [
            [f.joint_map.position(t) for f, t in zip(fences, row, strict=True)]
            for row in ticks.tolist()
        ]
    )


def _squared_norms(rows: Matrix) -> Vector:
    return np.sum(rows * rows, axis=1)


_ITERATIONS = 4
# Near a singularity a step would be large and of no use.
_DAMPING_M = 0.01
# A joint goes no further than this for another: a tool that tilts by more is another pose.
_MAX_STEP_RAD = 0.05


def compensate(chain: Chain, target_m: Vector, q: Vector, held: Collection[str]) -> Vector | None:
    """Return joints (dof,) near ``q`` that bring the tip to its target while some are held.

    Damped least squares (lecture L8) with the columns of the held joints left out: the smallest
    step of the others.

    Args:
        chain: Base to tool.
        target_m: Where the tip shall be (3,), metres.
        q: Where the joints are (dof,), rad or m.
        held: Names of the joints that stay.

    Returns:
        The joints, or None where the others cannot halve what is missing.
    """
    free = np.array([name not in held for name in chain.names])
    low, high = chain.clip(q - _MAX_STEP_RAD), chain.clip(q + _MAX_STEP_RAD)
    found = q
    for _ in range(_ITERATIONS):
        T, J = chain.forward_and_jacobian(found)
        J = J[:3] * free
        normal = J @ J.T + _DAMPING_M**2 * np.eye(3)
        step = J.T @ np.linalg.solve(normal, target_m - T[:3, 3])
        found = np.where(free, np.clip(found + step, low, high), q)
    before, after = (float(np.linalg.norm(chain.forward(x)[:3, 3] - target_m)) for x in (q, found))
    return found if after < 0.5 * before else None


class SettlingTarget:
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

    def __init__(
        self, chain: Chain, fences: Sequence[CommandLimits], plan: MotionPlan, stood: Vector
    ) -> None:
        self._chain, self._fences, self._target_m = chain, fences, plan.target_m
        names = [fence.joint for fence in fences]
        self._columns = [names.index(name) for name in chain.names]
        joints = zip(fences, plan.start, plan.goal, strict=True)
        self.ticks = [None if start == goal else f.tick(float(goal)) for f, start, goal in joints]
        for column in self._columns:
            if self.ticks[column] is None:
                self.ticks[column] = fences[column].tick(float(stood[column]))
        if plan.target_m is not None:
            self.ticks = self._round_to_nearest(plan.target_m, plan.goal[self._columns], ())

    def retarget_without(self, held: Collection[str], measured: Vector) -> list[int | None] | None:
        """Return where the joints belong when some can go no further, None if that is no help.

        Args:
            held: The joints that stay where they are.
            measured: Where all joints are (n,), rad or m.
        """
        if self._target_m is None or not set(held) & set(self._chain.names):
            return None
        q = compensate(self._chain, self._target_m, measured[self._columns], held)
        return None if q is None else self._round_to_nearest(self._target_m, q, held)

    def _round_to_nearest(
        self, target_m: Vector, q: Vector, held: Collection[str]
    ) -> list[int | None]:
        fences = [self._fences[column] for column in self._columns]
        narrowed = [
            replace(f, limits=Limits.of(f.joint, float(x), float(x), "held"))
            if f.joint in held
            else f
            for f, x in zip(fences, q, strict=True)
        ]
        wanted = list(self.ticks)
        found = round_to_ticks(self._chain, target_m, q, narrowed)
        for column, tick in zip(self._columns, found, strict=True):
            wanted[column] = tick
        return wanted


# So far below its place a joint has certainly come through its play.
_MARGIN_TICKS = 3


def backlash_approach(
    goals: Vector, moved: NDArray[np.bool_], backlash: Vector, fences: Sequence[CommandLimits]
) -> Vector | None:
    """Return goals (n,) from which each joint with known play creeps up to its place.

    On which flank of its play a joint comes to rest depends on where it came from and on how it
    braked: the same reading, the play apart. So it goes below its place by its play, and up.

    Args:
        goals: What the servos are told at the end of a motion (n,), rad or m.
        moved: Whether each joint took part in it (n,).
        backlash: The play of each (n,), rad or m; 0 where it is not known.
        fences: What each may be told.

    Returns:
        The goals, inside the limits; None where no joint with known play has moved.
    """
    chosen = moved & (backlash > 0.0)
    if not chosen.any():
        return None
    margin = np.array([_MARGIN_TICKS * fence.joint_map.unit_per_tick for fence in fences])
    lowest = np.array([fence.position_range[0] for fence in fences])
    below = np.maximum(goals - backlash - margin, np.minimum(lowest, goals))
    return np.where(chosen, below, goals)

"""Whole ticks near a solution that bring the tool closer to its target than rounding does."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ikservo.guard import Fence
from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["TURN_WORTH_M", "nearest_ticks"]

TURN_WORTH_M = 0.01
"""Turning the tool by one radian is as bad as missing by this: 0.17 mm for a degree."""

# A joint does not leave the solver's answer by a tick for less than this.
_TICK_WORTH_M = 2e-6
# So many combinations are looked at in half a millisecond.
_MOST_COMBINATIONS = 20_000
_FURTHEST_TICKS = 8
# Of these many, the best by the Jacobian, the tool's place is computed exactly.
_FINALISTS = 16


def nearest_ticks(
    chain: Chain, target_m: Vector, q: Vector, fences: Sequence[Fence]
) -> tuple[int, ...]:
    """Return the whole ticks near ``q`` with the smallest error of the tool.

    Every joint's rounding moves the tool a little; a few ticks more in one joint make up for
    another's. The search is for the whole numbers d with the least ``|E - A d|²``, where A is how
    the tool moves with a tick of each joint: three rows for its place, three for its turn away
    from how it stands at ``q``, these weighted by ``TURN_WORTH_M``. All combinations within some
    ticks are tried but for the joint that moves the tool most: its best tick follows from theirs.

    Args:
        chain: Base to tool.
        target_m: Where the tip shall be (3,), metres.
        q: The solver's answer (dof,), rad or m.
        fences: What each joint of the chain may be told, in its order.

    Returns:
        Ticks by joint, inside the limits, and never worse than the nearest ones.
    """
    start = np.array([_inside(f, float(v)) for f, v in zip(fences, q, strict=True)])
    steps = _promising(chain, target_m, q, fences, start)
    there = _positions(fences, start + steps)
    turns = TURN_WORTH_M * (there - q) @ chain.jacobian(q)[3:].T
    misses = chain.forward(there)[:, :3, 3] - target_m
    costs = _squares(misses) + _squares(turns) + _TICK_WORTH_M**2 * _squares(steps)
    return tuple(int(tick) for tick in start + steps[int(np.argmin(costs))])


def _promising(
    chain: Chain, target_m: Vector, q: Vector, fences: Sequence[Fence], start: Vector
) -> Matrix:
    """Return the most promising steps (k, dof) from the nearest ticks, no step at all the first."""
    here = _positions(fences, start[None])[0]
    T, J = chain.linearise(here)
    weights = np.array([1.0, 1.0, 1.0, TURN_WORTH_M, TURN_WORTH_M, TURN_WORTH_M])
    A = weights[:, None] * J * _units(fences, start)
    E = np.concatenate([target_m - T[:3, 3], TURN_WORTH_M * J[3:] @ (q - here)])
    low, high = (np.array(ends) - start for ends in zip(*(f.ticks for f in fences), strict=True))
    steps = _grid(A, low, high)
    lead = int(np.argmax(_squares(A.T)))
    left = E - steps @ A.T
    best = np.rint(left @ A[:, lead] / (A[:, lead] @ A[:, lead]))
    steps[:, lead] = np.clip(best, low[lead], high[lead])
    left -= steps[:, lead : lead + 1] * A[:, lead]
    costs = _squares(left) + _TICK_WORTH_M**2 * _squares(steps)
    finalists = np.argsort(costs, kind="stable")[:_FINALISTS]
    return np.vstack([np.zeros(len(start)), steps[finalists]])


def _grid(A: Matrix, low: Vector, high: Vector) -> Matrix:
    """Return all steps (k, dof) of all joints but the one that moves the tool most."""
    order = np.argsort(-_squares(A.T), kind="stable")[1:]
    axes = [np.zeros(1)] * A.shape[1]
    span, tried = _span(len(order))
    for joint in order[:tried].tolist():
        axes[joint] = np.arange(max(float(low[joint]), -span), min(float(high[joint]), span) + 1.0)
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)


def _span(joints: int) -> tuple[int, int]:
    """Return how many ticks to each side are tried, and in how many of so many joints."""
    for tried in range(joints, 0, -1):
        for span in range(_FURTHEST_TICKS, 0, -1):
            if (2 * span + 1) ** tried <= _MOST_COMBINATIONS:
                return span, tried
    return 0, 0


def _inside(fence: Fence, position: float) -> int:
    low, high = fence.ticks
    return min(max(fence.tick(position), low), high)


def _units(fences: Sequence[Fence], ticks: Vector) -> Vector:
    """Return what one tick more does to each joint there (dof,), rad or m, signed."""
    return np.array(
        [
            f.joint_map.position(t + 0.5) - f.joint_map.position(t - 0.5)
            for f, t in zip(fences, ticks.tolist(), strict=True)
        ]
    )


def _positions(fences: Sequence[Fence], ticks: Matrix) -> Matrix:
    """Return the joints (k, dof) at ticks (k, dof)."""
    return np.array(
        [
            [f.joint_map.position(t) for f, t in zip(fences, row, strict=True)]
            for row in ticks.tolist()
        ]
    )


def _squares(rows: Matrix) -> Vector:
    return np.sum(rows * rows, axis=1)

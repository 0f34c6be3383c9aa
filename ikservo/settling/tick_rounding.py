"""Round goals to whole ticks for the best tool position, and approach them from one side."""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from ikservo.calibration import Limits
from ikservo.guard import DrivenJoint
from ikservo.kinematics import Chain, JointIndex
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.planning.motion_plan import MotionPlan

ROTATION_WEIGHT_M = 0.01
"""Position error that counts as much as a rotation error of one radian: 0.17 mm per degree."""

# A joint does not leave the solver's result by a tick for a smaller gain, because that is where the
# motion ends, and a joint held by friction does not move by just one tick.
_TICK_WEIGHT_M = 3e-5
# This many combinations are evaluated in half a millisecond.
_MAX_COMBINATIONS = 20_000
_MAX_TICKS = 8  # largest change of a joint, in ticks
# The tool's pose is computed exactly for this many combinations, the best by the Jacobian.
_FINALISTS = 16


def round_to_ticks(
    chain: Chain, target_m: Vector, q: Vector, driven_joints: Sequence[DrivenJoint]
) -> tuple[int, ...]:
    """Compute the whole ticks near ``q`` with the smallest error of the tool.

    Every joint's rounding moves the tool slightly; a few ticks in one joint compensate for the
    rounding of another. The search is for the integers d with the least ``|E - A d|²``, where A is
    the motion of the tool per tick of each joint: three rows for its position, three for its
    rotation away from the orientation at ``q``, weighted by ``ROTATION_WEIGHT_M``. All combinations
    within a few ticks are tried, except for the joint that moves the tool most: its best tick
    follows from the ticks of the others.

    Args:
        chain: The joints from base to tool.
        target_m: The target of the tip (3,), metres.
        q: The solver's result (dof,), rad or m.
        driven_joints: The joints of the chain, in its order.

    Returns:
        Ticks by joint, inside the limits, and never worse than the nearest ticks.
    """
    low, high = np.transpose([driven.tick_range for driven in driven_joints])
    nearest = [driven.tick(at) for driven, at in zip(driven_joints, q.tolist(), strict=True)]
    start = np.clip(nearest, low, high)
    steps = _best_steps(chain, target_m, q, driven_joints, start)
    rounded = _positions_at(driven_joints, start + steps)
    rotation = ROTATION_WEIGHT_M * (rounded - q) @ chain.jacobian(q)[3:].T
    position = chain.forward(rounded)[:, :3, 3] - target_m
    costs = (
        _squared_norms(position)
        + _squared_norms(rotation)
        + _TICK_WEIGHT_M**2 * _squared_norms(steps)
    )
    return tuple(int(tick) for tick in start + steps[int(np.argmin(costs))])


def chain_ticks(
    chain: Chain,
    index: JointIndex,
    driven_joints: Sequence[DrivenJoint],
    goal: Vector,
    *,
    by_tip: bool,
) -> list[int | None]:
    """Compute the ticks of a goal of all joints (n,); None for joints outside the chain.

    Args:
        chain: The joints from base to tool.
        index: The columns of the chain's joints.
        driven_joints: The joints, each with its servo, limits and speed.
        goal: The positions, rad or m.
        by_tip: Whether to round for the tip, see ``round_to_ticks``; otherwise, for each joint.
    """
    q, own = index.chain_joints(goal), [driven_joints[column] for column in index.chain]
    found = [driven.tick(at) for driven, at in zip(own, q.tolist(), strict=True)]
    if by_tip:
        found = round_to_ticks(chain, chain.forward(q)[:3, 3], q, own)
    ticks = dict(zip(index.chain, found, strict=True))
    return [ticks.get(column) for column in range(len(driven_joints))]


def _best_steps(
    chain: Chain, target_m: Vector, q: Vector, driven_joints: Sequence[DrivenJoint], start: Vector
) -> Matrix:
    """Find the best candidate steps (k, dof) from the nearest ticks; the first is zero."""
    nearest = _positions_at(driven_joints, start[None])[0]
    T, J = chain.forward_and_jacobian(nearest)
    weights = np.array([1.0, 1.0, 1.0, ROTATION_WEIGHT_M, ROTATION_WEIGHT_M, ROTATION_WEIGHT_M])
    ahead, behind = _positions_at(driven_joints, start + np.array([[0.5], [-0.5]]))
    A = weights[:, None] * J * (ahead - behind)  # per tick of each joint
    E = np.concatenate([target_m - T[:3, 3], ROTATION_WEIGHT_M * J[3:] @ (q - nearest)])
    low, high = (
        np.array(ends) - start
        for ends in zip(*(driven.tick_range for driven in driven_joints), strict=True)
    )
    steps = _step_grid(A, low, high)
    lead = int(np.argmax(_squared_norms(A.T)))
    residual = E - steps @ A.T
    best = np.rint(residual @ A[:, lead] / (A[:, lead] @ A[:, lead]))
    steps[:, lead] = np.clip(best, low[lead], high[lead])
    residual -= steps[:, lead : lead + 1] * A[:, lead]
    costs = _squared_norms(residual) + _TICK_WEIGHT_M**2 * _squared_norms(steps)
    finalists = np.argsort(costs, kind="stable")[:_FINALISTS]
    return np.vstack([np.zeros(len(start)), steps[finalists]])


def _step_grid(A: Matrix, low: Vector, high: Vector) -> Matrix:
    """Compute all steps (k, dof) of all joints except the one that moves the tool most."""
    order = np.argsort(-_squared_norms(A.T), kind="stable")[1:]
    axes = [np.zeros(1)] * A.shape[1]
    span, tried = _search_span(len(order))
    for joint in order[:tried].tolist():
        axes[joint] = np.arange(max(float(low[joint]), -span), min(float(high[joint]), span) + 1.0)
    return np.stack([axis.ravel() for axis in np.meshgrid(*axes, indexing="ij")], axis=1)


def _search_span(joints: int) -> tuple[int, int]:
    """Find the number of ticks to try on each side, and the number of joints to vary."""
    for tried in range(joints, 0, -1):
        for span in range(_MAX_TICKS, 0, -1):
            if (2 * span + 1) ** tried <= _MAX_COMBINATIONS:
                return span, tried
    return 0, 0


def _positions_at(driven_joints: Sequence[DrivenJoint], ticks: Matrix) -> Matrix:
    """Compute the joints (k, dof) at ticks (k, dof)."""
    return np.array(
        [
            [driven.joint_map.position(t) for driven, t in zip(driven_joints, row, strict=True)]
            for row in ticks.tolist()
        ]
    )


def _squared_norms(rows: Matrix) -> Vector:
    return np.sum(rows * rows, axis=1)


_ITERATIONS = 4  # steps of Newton's method
# Near a singularity a step would be large and useless.
_DAMPING_M = 0.01
# A joint compensates for another by at most this: a tool that tilts further has another pose.
_MAX_STEP_RAD = 0.05


def compensate(chain: Chain, target_m: Vector, q: Vector, held: Collection[str]) -> Vector | None:
    """Compute joints (dof,) near ``q`` that bring the tip to its target while some joints are held.

    Damped least squares (lecture L8) without the columns of the held joints give the smallest step
    of the other joints.

    Args:
        chain: The joints from base to tool.
        target_m: The target of the tip (3,), metres.
        q: The joints (dof,), rad or m.
        held: Names of the joints that stay.

    Returns:
        The joints, or None if the other joints cannot halve the error.
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


# A tool is at its target if each joint and the tool are near it. With one tick, a joint that hardly
# moves the tool made other joints move, which were then a tick off their targets.
_REACHED_TICKS = 2.2  # distance of each joint: two ticks and sensor noise
_REACHED_ERRORS = 2.0  # distance of the tool, as a multiple of the rms error of rounding to ticks


class SettlingTarget:
    """The target ticks for the end of a motion.

    Joints of the chain that do not take part in a joint motion keep their measured position:
    their goals lead it by the sag under load, which changes with the arm's posture.

    Args:
        chain: The joints from base to tool.
        index: The columns of the chain's joints.
        driven_joints: The joints, each with its servo, limits and speed.
        plan: The motion.
        measured: The joints before the motion (n,), rad or m.

    Attributes:
        ticks: The tick of each joint; None for a joint outside the chain that does not take part: a
            gripper keeps its goal and continues to press.
    """

    def __init__(
        self,
        chain: Chain,
        index: JointIndex,
        driven_joints: Sequence[DrivenJoint],
        plan: MotionPlan,
        measured: Vector,
    ) -> None:
        self._chain, self._index, self._driven_joints = chain, index, driven_joints
        self._target_m = plan.target_m
        self._goal = index.chain_joints(plan.goal)
        self._tick = np.array(
            [driven_joints[column].joint_map.unit_per_tick for column in index.chain]
        )
        steps = chain.jacobian(self._goal)[:3] * self._tick
        self._hidden_m = float(np.linalg.norm(steps)) / math.sqrt(12.0)
        joints = zip(driven_joints, plan.start, plan.goal, strict=True)
        self.ticks = [
            None if start == goal else driven.tick(float(goal)) for driven, start, goal in joints
        ]
        for column in index.chain:
            if self.ticks[column] is None:
                self.ticks[column] = driven_joints[column].tick(float(measured[column]))
        if plan.target_m is not None:
            q = index.chain_joints(plan.goal)
            self.ticks = self._round_to_nearest(plan.target_m, q, ())

    def is_reached(self, measured: Vector) -> bool:
        """Check whether the tool is at its target according to the joints' sensors.

        The result is always False for a joint motion, because its joints have their own targets.

        Args:
            measured: All joints (n,), rad or m.
        """
        if self._target_m is None:
            return False
        q = self._index.chain_joints(measured)
        if np.any(np.abs(q - self._goal) > _REACHED_TICKS * self._tick):
            return False
        error_m = float(np.linalg.norm(self._chain.forward(q)[:3, 3] - self._target_m))
        return error_m <= _REACHED_ERRORS * self._hidden_m

    def retarget_without(self, held: Collection[str], measured: Vector) -> list[int | None] | None:
        """Compute the ticks of all joints if some cannot move further; None if that does not help.

        Args:
            held: The joints that cannot move further.
            measured: All joints (n,), rad or m.
        """
        if self._target_m is None or not set(held) & set(self._chain.names):
            return None
        q = compensate(self._chain, self._target_m, self._index.chain_joints(measured), held)
        return None if q is None else self._round_to_nearest(self._target_m, q, held)

    def _round_to_nearest(
        self, target_m: Vector, q: Vector, held: Collection[str]
    ) -> list[int | None]:
        driven_joints = [self._driven_joints[column] for column in self._index.chain]
        narrowed = [
            replace(driven, limits=Limits.of(driven.joint, float(x), float(x), "held"))
            if driven.joint in held
            else driven
            for driven, x in zip(driven_joints, q, strict=True)
        ]
        ticks = list(self.ticks)
        found = round_to_ticks(self._chain, target_m, q, narrowed)
        for column, tick in zip(self._index.chain, found, strict=True):
            ticks[column] = tick
        return ticks

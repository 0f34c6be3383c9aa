"""The tip of an arm: where it is, and the joint positions that bring it to a point."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from servosim.errors import SimulatorError
from servosim.gravity import MassTree, MimicDrive
from servosim.urdf import Matrix, MovingJoint

__all__ = ["Tip"]

NEAR_M = 1e-5  # a tick of a servo moves the tip of an arm ten times as far
ITERATIONS = 200
DAMPING_M = 0.01  # of the least-squares steps: keeps them short near singular postures
LONGEST_STEP = 0.2  # rad, or m: the slopes hold no further


class Tip:
    """The origin of a link, which the joints between it and the base move.

    Args:
        joints: The arm's moving joints, as in its URDF.
        driven: Which position moves each of them.
        tree: Their frames.
        parent: Index of the moving joint behind which the link is fixed, -1 at the base.
        offset_m: The link's origin in that joint's frame (3,).
        limits: Lower and upper limit of each position [rad or m].
    """

    def __init__(
        self,
        joints: Sequence[MovingJoint],
        driven: Sequence[MimicDrive],
        tree: MassTree,
        parent: int,
        offset_m: Matrix,
        limits: Sequence[tuple[float, float]],
    ) -> None:
        self._joints, self._driven, self._tree = joints, driven, tree
        self._parent, self._offset_m = parent, offset_m
        self._lower, self._upper = np.array(limits).T
        self._chain: list[int] = []
        while parent >= 0:
            self._chain.append(parent)
            parent = joints[parent].parent
        self.moved_by = frozenset(driven[i].driver for i in self._chain) - {-1}

    def position_m(self, positions: Sequence[float]) -> Matrix:
        """Return where the tip is (3,), base frame."""
        return self._origin_m(self._tree.frames(positions))

    def posture_at(self, point_m: Sequence[float], start: Sequence[float]) -> list[float]:
        """Return positions inside the limits with the tip at a point, near to those at the start.

        Where limits are in the way from the start, the search begins again in the middle of the
        joints' ranges.

        Args:
            point_m: In the base frame.
            start: The positions to search from.

        Raises:
            SimulatorError: No posture was found: the point is out of reach.
        """
        goal_m, shortest_m = np.array(point_m), math.inf
        for q in (np.array(start, dtype=float), self._middle()):
            found, short_m = self._search(goal_m, self._inside(q))
            if short_m < NEAR_M:
                return found.tolist()
            shortest_m = min(shortest_m, short_m)
        place = ", ".join(f"{x:.3f}" for x in point_m)
        short = f"{1000 * shortest_m:.1f} mm short"
        raise SimulatorError(f"the tip cannot be led to ({place}) m: {short}")

    def _search(self, goal_m: Matrix, q: Matrix) -> tuple[Matrix, float]:
        """Return the positions that damped least squares ends with, and how far off the tip is.

        Wampler 1986; a joint at a limit is left out of the steps that would push it further.
        """
        for _ in range(ITERATIONS):
            frames = self._tree.frames(q.tolist())
            gap_m = goal_m - self._origin_m(frames)
            if float(np.linalg.norm(gap_m)) < NEAR_M:
                break
            q = self._inside(q + self._step(q, self._slopes(frames), gap_m))
        return q, float(np.linalg.norm(goal_m - self.position_m(q.tolist())))

    def _middle(self) -> Matrix:
        """Return the middle of each range; zero where a joint has no limits."""
        bounded = np.isfinite(self._lower) & np.isfinite(self._upper)
        middle = np.zeros(len(bounded))
        middle[bounded] = (self._lower[bounded] + self._upper[bounded]) / 2.0
        return middle

    def _origin_m(self, frames: Matrix) -> Matrix:
        if self._parent < 0:
            return self._offset_m
        T = frames[self._parent]
        return T[:3, :3] @ self._offset_m + T[:3, 3]

    def _slopes(self, frames: Matrix) -> Matrix:
        """Return how the tip moves with each position (3, n)."""
        tip_m, J = self._origin_m(frames), np.zeros((3, len(self._lower)))
        for i in self._chain:
            driver, multiplier, _ = self._driven[i]
            axis, origin_m = frames[i, :3, 2], frames[i, :3, 3]
            moved = axis if self._joints[i].sliding else np.cross(axis, tip_m - origin_m)
            if driver >= 0:
                J[:, driver] += multiplier * moved
        return J

    def _step(self, q: Matrix, J: Matrix, gap_m: Matrix) -> Matrix:
        step = _least_squares(J, gap_m)
        outward = ((q <= self._lower) & (step < 0.0)) | ((q >= self._upper) & (step > 0.0))
        if outward.any():
            step = _least_squares(np.where(outward, 0.0, J), gap_m)
        return step / max(1.0, float(np.abs(step).max()) / LONGEST_STEP)

    def _inside(self, q: Matrix) -> Matrix:
        return np.clip(q, self._lower, self._upper)


def _least_squares(J: Matrix, gap_m: Matrix) -> Matrix:
    """Return the step (n,) for a gap (3,); the damping shrinks with the gap."""
    damping_m = min(DAMPING_M, float(np.linalg.norm(gap_m)))
    return J.T @ np.linalg.solve(J @ J.T + damping_m**2 * np.eye(3), gap_m)

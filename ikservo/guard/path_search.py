"""Search for a joint path around obstacles that block the straight path.

The compiled search (`ikservo.kernels.way_search`) checks samples. A path is shortened, and is
proven free before it is returned. If the proof fails for a motion of the path, this motion is
removed from its tree, sampling becomes finer, and the search continues. Results are reproducible,
because each search begins with the same seed, and counts its effort in postures, not seconds.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from ikservo.guard.clear_space import ClearSpace
from ikservo.guard.path_sampling import sample_line
from ikservo.kernels.compiled import bind, is_compiled
from ikservo.kernels.layout import work_shape
from ikservo.kinematics.arrays import IntVector, Matrix, Vector
from ikservo.kinematics.packed import WIDTH

_NODES = 100000  # most nodes of a tree
_STEP_M = 0.1  # spacing of postures on an edge of a tree at first
_FINEST_M = 0.002  # a shortcut that is free at this spacing is not refined further
_CHUNK = 2000  # number of postures between two checks whether the search must end
_CHUNK_IN_PYTHON = 20  # the same without compiled kernels
# After the first path, the search continues for shorter ones.
_MOST_WAYS = 8  # paths in all
_SEARCHED_AGAIN = 1  # multiple of the postures for the first path
_LEAST_AGAIN = 2500  # at least this number of postures
_SHORT = 1.4  # multiple of the straight distance; shorter paths are not improved
_SHORT_IN_TIME = 1.02  # the same for a search that may take its time
_FOR_EVER = 10**15  # number of postures that is never reached: only time ends the search
_SHORTER = 0.75  # the next path must be shorter by this factor
_ROOM = 200  # rows for the corners that shortcuts add
_SAME = 1e-9  # rounding of a joint at its limit, rad or m


class SearchedTool(Protocol):
    """Constraints of the tool on the path, for a search."""

    @property
    def arm(self) -> Matrix:
        """The packed chain."""
        ...

    @property
    def projected(self) -> Matrix:
        """Limits (k, 8) onto which postures are projected; see ``ikservo.kernels.tool_limits``."""
        ...

    @property
    def kept(self) -> Matrix:
        """Limits (k, 8) that ``keeps`` checks."""
        ...

    def keeps(self, joints: Matrix) -> NDArray[np.bool_]:
        """Check which joint vectors (n, dof) satisfy the limits; return a mask (n,)."""
        ...


def path_length(path: Matrix) -> float:
    """Compute the length of straight motions through postures (k, n), rad."""
    return float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())


class WaySearch:
    """A search for straight motions through postures (k, n) from a start to one of several goals.

    Args:
        space: The free space.
        start: The first posture (n,).
        goals: The possible ends (m, n).
        lower: The lowest positions (n,), finite.
        upper: The highest positions (n,).
        body: For each joint of the body (dof, 3): its column in a posture, or -1; the column's
            unit; the joint's position if there is no column. None if a posture has all joints.
        tool: The constraint of the tool on the path; None if it is free.
        columns: The column in a posture, and its unit, of each joint of the tool's chain (joints,
            2).
        seed: The seed of the random numbers.
        takes_time: Whether to shorten a path until the search must end, unless it is nearly
            straight.

    Attributes:
        has_ended: Whether the search is over: a path was found, no end is free, or the search has
            become too large.
    """

    def __init__(
        self,
        space: ClearSpace,
        start: Vector,
        goals: Matrix,
        lower: Vector,
        upper: Vector,
        *,
        body: Matrix | None = None,
        tool: SearchedTool | None = None,
        columns: Matrix | None = None,
        seed: int = 1,
        takes_time: bool = False,
    ) -> None:
        from ikservo.kernels import way_search as kernel  # noqa: PLC0415  # as in the checker

        n, self._kernel = len(start), kernel
        every = np.column_stack([np.arange(n, dtype=np.float64), np.ones(n), np.zeros(n)])
        self._space, self._tool, self._start = space, tool, start
        self._takes_time = takes_time
        self._body = every if body is None else body
        self._moved = np.flatnonzero(self._body[:, 0] >= 0.0)
        self._moved_by = self._body[self._moved, 0].astype(np.intp)
        self._columns = np.zeros((0, 2)) if columns is None or tool is None else columns
        inside = (goals >= lower - _SAME).all(axis=1) & (goals <= upper + _SAME).all(axis=1)
        self._goals = goals[inside]
        self._goals = self._goals[self._contains(self._goals)] if inside.any() else self._goals
        self.has_ended = not (len(self._goals) and self._contains(start[None])[0])
        self._limits = np.array([np.minimum(lower, start), np.maximum(upper, start)])
        self._step_m, self._chunk = _STEP_M, _CHUNK if is_compiled() else _CHUNK_IN_PYTHON
        self._state = np.zeros(kernel.STATE_SIZE, np.int64)
        chance = np.random.default_rng(seed).integers(1, kernel.CHANCES, 2)
        self._state[kernel.CHANCE : kernel.CHANCE + 2] = chance
        self._state[kernel.HIT] = -1
        self._plant(self._limits)

    def find(self, most: int, is_over: Callable[[], bool] = bool) -> Matrix | None:
        """Continue the search until a path is found and proven free.

        At most ``most`` postures are checked; the search also ends once ``is_over`` returns True.

        Returns:
            The postures (k, n) of the path; None if none was found yet, or the start or all goals
            are not free.
        """
        if self.has_ended:
            return None
        for goal in self._goals if self._state[self._kernel.LOOKED] == 0 else ():
            straight = np.array([self._start, goal])
            if self._is_proven(straight):
                self.has_ended = True
                return straight
        until = int(self._state[self._kernel.LOOKED]) + most
        while not self.has_ended and self._has_met(until, is_over):
            way = self._proven_way(is_over)
            if way is not None:
                self.has_ended = True
                return way
        return None

    def _has_met(self, until: int, is_over: Callable[[], bool]) -> bool:
        """Grow the trees, up to ``until`` checked postures; return whether the trees have met."""
        looked = self._kernel.LOOKED
        while self._state[looked] < until and not (self.has_ended or is_over()):
            before = self._state[looked]
            if self._grow_trees(self._step_m, min(until, before + self._chunk)):
                return True
            self.has_ended = bool(self._state[looked] == before)  # a tree is full
        return False

    def _bound(
        self, name: str, limits: Matrix, nodes: Matrix, parents: IntVector, state: IntVector
    ) -> Callable[..., object]:
        """Return a kernel function with all arguments bound except the last two, step and bound."""
        tool, dof = self._tool, len(self._columns)
        nothing = np.zeros((0, 8))
        return bind(
            name, *self._space.sampled, self._body, limits,
            np.zeros((0, WIDTH)) if tool is None else tool.arm,
            nothing if tool is None else tool.projected,
            nothing if tool is None else tool.kept,
            self._columns, np.zeros(work_shape(dof, 1)), np.zeros(dof),
            np.zeros((self._kernel.BUFFER_ROWS, len(self._start))), nodes, parents, state,
        )  # fmt: skip

    def _plant(self, limits: Matrix) -> None:
        """Start both trees in new arrays; postures are sampled within limits (2, n)."""
        kernel, n, goals = self._kernel, len(self._start), len(self._goals)
        self._nodes, self._parents = np.empty((2 * _NODES, n)), np.empty(2 * _NODES, np.int64)
        self._nodes[0], self._nodes[_NODES : _NODES + goals] = self._start, self._goals
        self._parents[0] = self._parents[_NODES : _NODES + goals] = -1
        self._state[kernel.SIZES : kernel.SIZES + 2] = 1, goals
        self._state[kernel.MET : kernel.MET + 2] = -1
        self._grow_trees = self._bound(
            "grow_trees", limits, self._nodes, self._parents, self._state
        )

    def _other_ways(self, way: Matrix, is_over: Callable[[], bool]) -> list[Matrix]:
        """Search for other paths with other random numbers, unless the path is already short."""
        looked, before = self._kernel.LOOKED, (self._nodes, self._parents, self._grow_trees)
        until = self._state[looked] + max(_SEARCHED_AGAIN * int(self._state[looked]), _LEAST_AGAIN)
        until = _FOR_EVER if self._takes_time else int(until)
        kept = self._state[self._kernel.SIZES : looked].copy()
        straight = np.linalg.norm(self._goals - self._start, axis=1).min()
        enough = straight * (_SHORT_IN_TIME if self._takes_time else _SHORT)
        shorter, most = (1.0, until) if self._takes_time else (_SHORTER, _MOST_WAYS)
        ways = [way]
        while (
            len(ways) < most
            and self._state[looked] < until
            and min(map(path_length, ways)) > enough
            and not is_over()
        ):
            self._plant(self._limits_of_ways(shorter * min(map(path_length, ways))))
            if self._has_met(until, is_over):
                ways.append(self._shortened(self._way(*self._branches()), self._step_m))
        self._nodes, self._parents, self._grow_trees = before
        self._state[self._kernel.SIZES : looked] = kept
        return ways[1:]

    def _limits_of_ways(self, length: float) -> Matrix:
        """Return limits (2, n) that contain all paths up to a length, rad."""
        apart = self._goals - self._start
        aside2 = np.maximum(length**2 - (apart**2).sum(axis=1), 0.0)
        half, middle = 0.5 * np.sqrt(apart**2 + aside2[:, None]), self._start + 0.5 * apart
        low, high = (middle - half).min(axis=0), (middle + half).max(axis=0)
        return np.clip([low, high], *self._limits)

    def _proven_way(self, is_over: Callable[[], bool]) -> Matrix | None:
        """Return the shortest proven path; None if a motion was not free and has been removed."""
        out, home = self._branches()
        way, step_m = self._way(out, home), self._step_m
        shorter = self._shortened(way, step_m)
        # After a failed proof, other paths are not searched again.
        if step_m == _STEP_M or self._is_proven(shorter):
            ways = [shorter, *self._other_ways(shorter, is_over)]
            for shortest in sorted(ways, key=path_length):
                if self._is_proven(shortest):
                    return shortest
        motions = enumerate(itertools.pairwise(way))
        at = next((i for i, ends in motions if not self._is_proven(np.array(ends))), None)
        if at is not None:
            if at < len(out) - 1:
                self._remove_branch(0, out[-2 - at])
            else:
                self._remove_branch(1, home[at - len(out) + 1])
            self._state[self._kernel.MET : self._kernel.MET + 2] = -1
            self._step_m = max(0.5 * step_m, _FINEST_M)
            return None
        while step_m > _FINEST_M:
            step_m *= 0.5
            shorter = self._shortened(way, step_m)
            if self._is_proven(shorter):
                return shorter
        return way

    def _branches(self) -> tuple[list[int], list[int]]:
        """Return the tree rows from the meeting point to the start, and from there to a goal."""
        found = list[int](), list[int]()
        for rows, met in zip(found, self._state[self._kernel.MET :], strict=False):
            row = int(met)
            while row >= 0:
                rows.append(row)
                row = int(self._parents[row])
        return found

    def _way(self, out: list[int], home: list[int]) -> Matrix:
        """Return the postures (k, n) of the path where the trees met, from start to goal."""
        return self._nodes[out[::-1] + home[1:]]

    def _remove_branch(self, tree: int, row: int) -> None:
        """Remove a node and all nodes that were reached from it."""
        sizes = self._kernel.SIZES
        first, size = tree * _NODES, int(self._state[sizes + tree])
        nodes, parents = self._nodes[first : first + size], self._parents[first : first + size]
        before = (parents - first).tolist()
        kept = np.ones(size, dtype=np.bool_)
        kept[row - first] = False
        for i in range(row - first + 1, size):
            kept[i] = before[i] < 0 or kept[before[i]]
        at = first + np.cumsum(kept) - 1
        left = parents[kept]
        left = np.where(left < 0, -1, at[np.maximum(left - first, 0)])
        nodes[: len(left)], parents[: len(left)] = nodes[kept], left
        self._state[sizes + tree] = len(left)

    def _shortened(self, way: Matrix, step_m: float) -> Matrix:
        """Shorten a path (k, n) by shortcuts that are free at all samples."""
        room = len(way) + _ROOM
        nodes, state = np.zeros((2 * room, way.shape[1])), self._state.copy()
        nodes[: len(way)] = way
        sizes = self._kernel.SIZES
        state[sizes : sizes + 2] = len(way), 1
        self._bound("shorten_way", self._limits, nodes, np.zeros(2 * room, np.int64), state)(
            step_m, 0
        )
        self._state[self._kernel.LOOKED] = state[self._kernel.LOOKED]
        return nodes[: state[sizes]].copy()

    def _is_proven(self, way: Matrix) -> bool:
        """Check whether all motions of a path (k, n) are proven free."""
        if not self._space.is_free(self._bodies(way)):
            return False
        if self._tool is None:
            return True
        chains = way[:, self._columns[:, 0].astype(int)] * self._columns[:, 1]
        return all(
            self._tool.keeps(sample_line(*ends)).all() for ends in itertools.pairwise(chains)
        )

    def _contains(self, postures: Matrix) -> NDArray[np.bool_]:
        free = self._space.contains(self._bodies(postures))
        if self._tool is not None:
            chains = postures[:, self._columns[:, 0].astype(int)] * self._columns[:, 1]
            free &= self._tool.keeps(chains)
        return free

    def _bodies(self, postures: Matrix) -> Matrix:
        """Return the joints of the body (k, dof) in postures (k, n)."""
        bodies = np.empty((len(postures), len(self._body)))
        bodies[:] = self._body[:, 2]
        bodies[:, self._moved] = postures[:, self._moved_by] * self._body[self._moved, 1]
        return bodies

"""How the other joints must stand while one joint is driven to a stop and touches nothing else."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Sequence
from itertools import chain, islice

import numpy as np

from ikservo.errors import RefusedError
from ikservo.guard import Box, Space, sample_line
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.model import Model
from ikservo.model.shell import body_of

__all__ = ["Postures"]

_LOOKS = 30
_TRIES, _DETOURS = 400, 40
_INSIDE_RAD = 0.26  # from the arm file's ends: nobody knows yet where the true ones are
# So near its end a joint may meet its own neighbour: that is what many stops are. What it never
# may meet is the table, or a thing that stands there.
_NEIGHBOURLY_RAD = 0.22


class Postures:
    """Finds postures of one arm that is described but not yet measured.

    Args:
        model: The arm.
    """

    def __init__(self, model: Model) -> None:
        self._body, self._floor_m = body_of(model), model.floor_m
        self._boxes = [Box(b.name, np.array(b.low_m), np.array(b.high_m)) for b in model.keep_out]
        self.space = Space(self._body, model.floor_m, self._boxes)
        self._known = [model.chain_pose(name) for name in model.poses]
        low = np.maximum(model.chain.lower_rad, -np.pi) + _INSIDE_RAD
        high = np.minimum(model.chain.upper_rad, np.pi) - _INSIDE_RAD
        self._low, self._high = np.minimum(low, high), np.maximum(low, high)

    def towards(self, column: int, start: float, end: float, here: Vector) -> list[Vector] | None:
        """Return the way to a posture from which a joint can go to its end.

        Args:
            column: The joint's place in the chain's vectors.
            start: From where it goes, rad or m.
            end: Where its stop is expected, and a little beyond.
            here: Where the arm is (dof,).

        Returns:
            Postures (dof,) one after the other, the last with the joint at its start; None where
            the arm would touch something in every posture that was tried.
        """
        for posture in chain([here], self._known, islice(self._by_chance(), _TRIES)):
            begin: Vector = posture.copy()
            begin[column] = start
            if self._may_go(begin, column, end):
                way = self.way(here, begin)
                if way is not None:
                    return way
        return None

    def way(self, here: Vector, goal: Vector) -> list[Vector] | None:
        """Return postures (dof,) by which the arm gets to a goal and touches nothing, or None."""
        if self._is_free(sample_line(here, goal)):
            return [goal]
        for between in self._detours():
            if self._is_free(sample_line(here, between)) and self._is_free(
                sample_line(between, goal)
            ):
                return [between, goal]
        return None

    def _detours(self) -> Iterable[Vector]:
        return chain(self._known, islice(self._by_chance(), _DETOURS))

    def _by_chance(self) -> Iterator[Vector]:
        chance = np.random.default_rng(1)  # the same arm is treated alike each time
        while True:
            yield chance.uniform(self._low, self._high)

    def _may_go(self, begin: Vector, column: int, end: float) -> bool:
        start = begin[column]
        near = max(abs(end - start) - _NEIGHBOURLY_RAD, 0.0)
        short = start + np.sign(end - start) * near
        if not self._clears_surroundings(_swept(begin, column, end)):
            return False
        return self._is_free(_swept(begin, column, short))

    def _clears_surroundings(self, way: Matrix) -> bool:
        gaps = [self._body.beside(way, b.low_m, b.high_m, b.name) for b in self._boxes]
        if self._floor_m is not None:
            gaps.append(self._body.above(way, self._floor_m))
        return all(bool((gap.gap_m >= 0.0).all()) for gap in gaps)

    def _is_free(self, way: Sequence[Vector] | Matrix) -> bool:
        try:
            self.space.check_way(list(way))
        except RefusedError:
            return False
        return True


def _swept(begin: Vector, column: int, end: float) -> Matrix:
    rows: Matrix = np.tile(begin, (_LOOKS, 1))
    rows[:, column] = np.linspace(begin[column], end, _LOOKS)
    return rows

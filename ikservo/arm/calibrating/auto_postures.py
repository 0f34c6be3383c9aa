"""How the other joints must stand while one joint is driven to a stop and touches nothing else."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
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
_INSIDE_MEASURED_RAD = 0.06  # from ends that have been measured
# So near its end a joint may meet its own neighbour: that is what many stops are. What it never
# may meet is the table, or a thing that stands there.
_NEIGHBOURLY_RAD = 0.22
# Postures by chance seldom leave room for a long arm above its table; the best are improved.
_IMPROVED = 10
_WIDE_RAD, _FINE_RAD = 0.4, 0.03
_ENOUGH_M = 0.004


class Postures:
    """Finds postures of one arm that is described but not yet measured.

    Args:
        model: The arm.
    """

    def __init__(self, model: Model) -> None:
        body = body_of(model)
        self._own = len(body.pairs)
        boxes = [Box(b.name, np.array(b.low_m), np.array(b.high_m)) for b in model.keep_out]
        self.space = Space(body, model.floor_m, boxes)
        self._known = [model.chain_pose(name) for name in model.poses]
        low = np.maximum(model.chain.lower_rad, -np.pi) + _INSIDE_RAD
        high = np.minimum(model.chain.upper_rad, np.pi) - _INSIDE_RAD
        self._low, self._high = np.minimum(low, high), np.maximum(low, high)

    def learn(self, column: int, low: float, high: float) -> None:
        """Take the measured range of a joint: it may stand nearer to ends that are known."""
        low, high = low + _INSIDE_MEASURED_RAD, high - _INSIDE_MEASURED_RAD
        if low < high:
            self._low[column], self._high[column] = low, high

    def towards(self, column: int, start: float, end: float, here: Vector) -> list[Vector]:
        """Return the way to a posture from which a joint can go to its end.

        Args:
            column: The joint's place in the chain's vectors.
            start: From where it goes, rad or m.
            end: Where its stop is expected, and a little beyond.
            here: Where the arm is (dof,).

        Returns:
            Postures (dof,) one after the other, the last with the joint at its start.

        Raises:
            RefusedError: The arm would touch something in every posture that was tried; says
                what in the best of them.
        """
        drive = _Drive(column, start, end)
        nearest = (-np.inf, "")
        for posture in chain([here], self._known, self._improved(drive)):
            begin = drive.begun(posture)
            nearest = max(nearest, self._least(drive, begin))
            if self._may_go(begin, drive):
                way = self.way(here, begin)
                if way is not None:
                    return way
        raise RefusedError(_blocked(*nearest))

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

    def _improved(self, drive: _Drive) -> Iterator[Vector]:
        """Yield the postures by chance that leave most room, each improved joint by joint."""
        found = [drive.begun(posture) for posture in islice(self._by_chance(), _TRIES)]
        found.sort(key=lambda begin: self._least(drive, begin)[0], reverse=True)
        for begin in found[:_IMPROVED]:
            yield self._climbed(begin, drive)

    def _climbed(self, begin: Vector, drive: _Drive) -> Vector:
        """Return a posture from which small changes of single joints leave no more room."""
        best, best_m, step = begin, self._least(drive, begin)[0], _WIDE_RAD
        while step >= _FINE_RAD and best_m < _ENOUGH_M:
            rows = self._beside(best, step, drive.column)
            gap_m, row = max((self._least(drive, row)[0], i) for i, row in enumerate(rows))
            if gap_m > best_m:
                best, best_m = rows[row], gap_m
            else:
                step /= 2
        return best

    def _beside(self, posture: Vector, step: float, column: int) -> Matrix:
        """Return the postures (n, dof) in which one other joint stands a step elsewhere."""
        steps = step * np.vstack([np.eye(len(posture)), -np.eye(len(posture))])
        steps[:, column] = 0.0
        rows = np.clip(posture + steps, self._low, self._high)
        rows[:, column] = posture[column]
        return rows

    def _least(self, drive: _Drive, begin: Vector) -> tuple[float, str]:
        """Return the least gap [m] on the way to an end, and between what it is."""
        gap_m = self._gaps(drive, begin).min(axis=0)
        pair = int(np.argmin(gap_m))
        return float(gap_m[pair]), " would touch ".join(self.space.pairs[pair])

    def _gaps(self, drive: _Drive, begin: Vector) -> Matrix:
        """Return the gaps (looks, pairs) [m] that count on the way of a joint to its end."""
        way = drive.swept(begin)
        gap_m = self.space.gaps(way)
        gap_m[np.abs(way[:, drive.column] - drive.start) > drive.alone, : self._own] = np.inf
        return gap_m

    def _may_go(self, begin: Vector, drive: _Drive) -> bool:
        around_m = self.space.gaps(drive.swept(begin))[:, self._own :]
        if not (around_m >= 0.0).all():
            return False
        return self._is_free(drive.swept(begin, drive.alone))

    def _is_free(self, way: Sequence[Vector] | Matrix) -> bool:
        try:
            self.space.check_way(list(way))
        except RefusedError:
            return False
        return True


@dataclass(frozen=True, slots=True)
class _Drive:
    """One joint's way to its end, whatever the others do; rad or m.

    Attributes:
        column: The joint's place in the chain's vectors.
        start: From where it goes.
        end: Where to.
    """

    column: int
    start: float
    end: float

    @property
    def alone(self) -> float:
        """Return how far it goes before it may meet its neighbour."""
        return max(abs(self.end - self.start) - _NEIGHBOURLY_RAD, 0.0)

    def begun(self, posture: Vector) -> Vector:
        """Return a posture with the joint at its start."""
        begin = posture.copy()
        begin[self.column] = self.start
        return begin

    def swept(self, begin: Vector, most: float = math.inf) -> Matrix:
        """Return the way (looks, dof), no further than so far from its start."""
        far = min(abs(self.end - self.start), most)
        rows: Matrix = np.tile(begin, (_LOOKS, 1))
        rows[:, self.column] += np.linspace(0.0, math.copysign(far, self.end - self.start), _LOOKS)
        return rows


def _blocked(gap_m: float, touch: str) -> str:
    if gap_m >= 0.0:
        return "no free path was found to a posture that leaves room for it"
    return f"{touch} by {-gap_m * 1e3:.0f} mm in the best posture found"

"""Where the arm's body may be: clear of itself, above the floor, outside keep-out boxes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ikservo.errors import BadValueError, RefusedError
from ikservo.kinematics.body import Body
from ikservo.kinematics.numbers import finite_vectors
from ikservo.kinematics.se3 import Matrix, Vector

__all__ = ["Box", "Space"]

_TOUCH_M = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Box:
    """An upright box that the arm keeps out of.

    Attributes:
        name: As a person calls it: ``the cup``.
        low_m: Its lowest corner (3,), metres, base frame.
        high_m: Its highest corner (3,).

    Raises:
        BadValueError: A corner is not finite, or low_m is not below high_m.
    """

    name: str
    low_m: Vector
    high_m: Vector

    def __post_init__(self) -> None:
        corners = np.array([self.low_m, self.high_m], dtype=np.float64)
        if not (np.isfinite(corners).all() and (corners[0] < corners[1]).all()):
            raise BadValueError(f"The box {self.name}", corners.tolist(), "low < high, finite")


class Space:
    """Looks at where the body goes before it moves.

    Args:
        body: The arm's capsules; where its vectors end with the gripper's joint, the jaws are
            looked at where they are.
        floor_m: Height of the table in the base frame; None for none.
        boxes: What else to keep out of.

    Attributes:
        pairs: What comes near what: a link, and another link or the name of a thing.
    """

    def __init__(self, body: Body, floor_m: float | None = 0.0, boxes: Sequence[Box] = ()) -> None:
        self._body = packed = body.packed()
        self._floor_m = -math.inf if floor_m is None else floor_m
        self._boxes = np.array([[*box.low_m, *box.high_m] for box in boxes]).reshape(len(boxes), 6)
        things = ["the floor", *(box.name for box in boxes)]
        around = [(link, thing) for thing in things for link in packed.names]
        self.pairs = (*packed.pairs, *around)
        self._overlap_m = np.zeros(len(self.pairs))
        self._overlap_m[: len(packed.pairs)] = packed.overlap_m
        # What stands on the table touches it.
        self._watched = np.array([link != packed.base for link, _ in self.pairs])
        self._watched[: len(packed.pairs)] = True

    @property
    def dof(self) -> int:
        """Return the length of the joint vectors."""
        return self._body.dof

    def check_way(self, way: Sequence[Vector]) -> None:
        """Check joint vectors (dof,) along a way, the first being where the arm is.

        An arm that lies on the table, or on itself, may get up: what touches at the start is
        looked at only from where it is free. It must not end deeper than it began. A stream
        looks at a way of two: where it is, and where it would stop.

        Raises:
            RefusedError: Something would be touched; says what, and how far along the way.
            BadValueError: A joint is no number.
        """
        gap_m = self.gaps(way)
        looks, pairs = np.nonzero(_touching(gap_m))
        if len(looks):
            share = int(looks[0]) / (len(gap_m) - 1)
            raise self._touch(f"On the way, {share:.0%} along, ", gap_m[looks[0]], int(pairs[0]))

    def check_pose(self, q: Vector) -> None:
        """Check one posture (dof,), wherever the arm is now.

        Raises:
            RefusedError: Something would be touched; says what.
            BadValueError: A joint is no number.
        """
        (gap_m,) = self.gaps([q])
        nearest = int(np.argmin(gap_m))
        if not gap_m[nearest] >= -_TOUCH_M:
            raise self._touch("There ", gap_m, nearest)

    def gaps(self, way: Sequence[Vector]) -> Matrix:
        """Return how near each pair of things comes (n, pairs) [m] in postures (n, dof)."""
        from ikservo.guard.nearness import gaps  # noqa: PLC0415  # imports numba

        body, q = self._body, finite_vectors(np.array(way), self._body.dof, "q")
        found = np.full((len(q), len(self.pairs)), np.inf)
        places, ends = np.empty((len(body.links), 12)), np.empty((len(body.capsules), 6))
        gaps(
            body.links, body.capsules, body.rows, self._floor_m, self._boxes, q, places, ends, found
        )
        found += self._overlap_m
        found[:, ~self._watched] = np.inf
        return found

    def _touch(self, where: str, gap_m: Vector, pair: int) -> RefusedError:
        link, other = self.pairs[pair]
        return RefusedError(
            f"{where}{link} would touch {other} ({-gap_m[pair] * 1e3:.1f} mm deep).",
            "Nothing was sent. Go by another point, mend the surroundings in the arm file, or use "
            "--no-collision where you see that the way is free.",
        )


def _touching(gap_m: Matrix) -> NDArray[np.bool_]:
    """Return (looks, pairs) where a pair touches that need not."""
    been_free = np.logical_or.accumulate(gap_m >= -_TOUCH_M, axis=0)
    touching = ~(gap_m >= -_TOUCH_M) & been_free
    touching[-1] |= ~(gap_m[-1] >= np.minimum(gap_m[0], 0.0) - _TOUCH_M)
    return touching

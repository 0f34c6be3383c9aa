"""Where the arm's body may be: clear of itself, above the floor, outside keep-out boxes."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ikservo.errors import BadValueError, RefusedError
from ikservo.kinematics.body import Body, Gaps
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
    """Looks at the way of the body before a motion starts.

    Args:
        body: The arm's capsules.
        floor_m: Height of the table in the base frame; None for none.
        boxes: What else to keep out of.
    """

    def __init__(self, body: Body, floor_m: float | None = 0.0, boxes: Sequence[Box] = ()) -> None:
        self._body, self._floor_m, self._boxes = body, floor_m, tuple(boxes)

    def check_way(self, way: Sequence[Vector]) -> None:
        """Check joint vectors (dof,) along a way, the first being where the arm is.

        An arm that lies on the table, or on itself, may get up: what touches at the start is
        looked at only from where it is free. It must not end deeper than it began.

        Raises:
            RefusedError: Something would be touched; says what, and how far along the way.
        """
        for gaps in self._gaps(np.array(way)):
            touching = _touching(gaps.gap_m)
            looks, pairs = np.nonzero(touching)
            if len(looks):
                first, pair = int(looks[0]), int(pairs[0])
                share = first / max(1, len(way) - 1)
                raise _touch(*gaps.pairs[pair], float(gaps.gap_m[first, pair]), share)

    def _gaps(self, q: Matrix) -> Iterator[Gaps]:
        yield self._body.between_links(q)
        if self._floor_m is not None:
            yield self._body.above(q, self._floor_m)
        for box in self._boxes:
            yield self._body.beside(q, box.low_m, box.high_m, box.name)


def _touching(gap_m: Matrix) -> NDArray[np.bool_]:
    """Return (looks, pairs) where a pair touches that need not."""
    been_free = np.logical_or.accumulate(gap_m >= -_TOUCH_M, axis=0)
    touching = (gap_m < -_TOUCH_M) & been_free
    touching[-1] |= gap_m[-1] < np.minimum(gap_m[0], 0.0) - _TOUCH_M
    return touching


def _touch(link: str, other: str, gap_m: float, share: float) -> RefusedError:
    return RefusedError(
        f"On the way, {share:.0%} along, {link} would touch {other} ({-gap_m * 1000:.1f} mm deep).",
        "Nothing was sent. Go by another point, mend the surroundings in the arm file, or use "
        "--no-collision where you see that the way is free.",
    )

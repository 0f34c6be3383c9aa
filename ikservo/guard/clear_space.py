"""The space in which an arm keeps a distance to everything, asked about many motions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ikservo.guard.sag import GravitySag
from ikservo.kernels.compiled import bind
from ikservo.kinematics.arrays import Matrix, Vector, finite_vectors
from ikservo.kinematics.packed import CAPSULE_WIDTH, END, LINK, RADIUS, START, PackedBody

# The links of an arm that gives way are followed straight between postures so far apart. Torques
# are sines of sums of joints: where three joints turn together and one gives way by 0.1 rad, the
# links are at most about 0.001 rad beside that.
_BENDING_STEP_RAD = 0.1


class ClearSpace:
    """Postures, and straight motions between them, that keep a distance to everything.

    A motion is followed without a gap: nothing comes nearer by a millimetre than is allowed,
    however thin it is. One thread at a time may ask. ``CollisionChecker.clear_space`` makes it.

    Args:
        body: The arm.
        shapes: The things (k, 17) but the table; see ``kinematics.packed``.
        floor_m: The height of the table; minus infinity for none.
        allowed_m: The distances (2, pairs) to keep, of the capsules themselves; below, those of the
            arm that sags.
        sag: The sag of the arm under gravity; None if it is not considered.
        load: Multiple of gravity under which it does.
        bends: Returns where the links are (n, dof) from where the joints' sensors are; None for an
            arm that does not give way behind them.
        sampled_m: The distances (2, pairs) that searches which look at samples keep there; as
            ``allowed_m`` if None.

    Attributes:
        sampled: The arrays that such searches give to the kernel.
    """

    def __init__(
        self,
        body: PackedBody,
        shapes: Matrix,
        floor_m: float,
        allowed_m: Matrix,
        sag: GravitySag | None,
        load: float,
        bends: Callable[[Matrix], Matrix] | None = None,
        sampled_m: Matrix | None = None,
    ) -> None:
        from ikservo.kernels import free_path as free_path_kernel  # noqa: PLC0415  # as the checker's

        self._bends = bends
        self._no_contact, self._dof, links = free_path_kernel.FREE, body.dof, len(body.names)
        halves_m, balls = _balls(body)
        rows = body.rows[np.argsort(body.rows[:, 2], kind="stable")]
        after = np.searchsorted(rows[:, 2], rows[:, 2], side="right")
        pairs = np.column_stack([rows, after])
        arguments = (
            body.links, body.capsules, halves_m, balls, pairs, shapes, floor_m,
            np.vstack([body.pair_reach_m, body.reach_m]),
            np.zeros((links, 4)) if sag is None else sag.masses,
            np.zeros((3, body.dof)) if sag is None else sag.bounds,
            np.empty((links, 12)), np.empty((len(body.capsules), 6)), np.empty((links, 4)),
            np.empty((3, body.dof)), np.zeros(len(body.pairs) + links), allowed_m,
            0.0 if sag is None else load,
        )  # fmt: skip
        sampled_m = allowed_m if sampled_m is None else sampled_m
        self.sampled = (*arguments[:-2], sampled_m, arguments[-1])
        self._first_contact = bind("first_contact", *arguments)
        self._free_postures = bind("free_postures", *arguments)

    def is_free(self, path: Matrix) -> bool:
        """Tell whether the straight motions through postures (n, dof) keep the distances."""
        if self._bends is not None:
            pieces = [_close_postures(a, b) for a, b in itertools.pairwise(path)]
            path = self._bends(np.vstack([path[:1], *pieces]))
        # Without compiled kernels the comparison is a NumPy bool, which OMPL does not take.
        return bool(self._first_contact(path) == self._no_contact)

    def contains(self, postures: Matrix) -> NDArray[np.bool_]:
        """Return for each posture (n, dof) whether it keeps the distances (n,)."""
        q = finite_vectors(np.array(postures), self._dof, "q")
        if self._bends is not None:
            q = self._bends(q)
        free = np.zeros(len(q), dtype=np.int64)
        self._free_postures(q, free)
        return free == 1


def _close_postures(start: Vector, goal: Vector) -> Matrix:
    """Return postures (k, dof) on the straight way to another, which is the last of them."""
    count = max(1, math.ceil(float(np.abs(goal - start).max()) / _BENDING_STEP_RAD))
    return np.linspace(start, goal, count + 1)[1:]


def _balls(body: PackedBody) -> tuple[Vector, Matrix]:
    """Compute half the length of each capsule, and a ball around those of each link."""
    from ikservo.kernels.free_path import FIRST_CAPSULE, LAST_CAPSULE  # noqa: PLC0415

    starts, ends = body.capsules[:, START : START + 3], body.capsules[:, END : END + 3]
    balls = np.zeros((len(body.names), CAPSULE_WIDTH))
    balls[:, LINK] = np.arange(len(body.names))
    for link, ball in enumerate(balls):
        own = body.capsules[:, LINK] == link
        if own.any():
            points = np.vstack([starts[own], ends[own]])
            centre = 0.5 * (points.min(axis=0) + points.max(axis=0))
            ball[START : START + 3] = centre
            ball[FIRST_CAPSULE] = first = own.argmax()  # those of a link stand together
            ball[LAST_CAPSULE] = first + own.sum()
            apart_m = np.linalg.norm(points - centre, axis=1)
            ball[RADIUS] = (apart_m + np.tile(body.capsules[own, RADIUS], 2)).max()
    return 0.5 * np.linalg.norm(ends - starts, axis=1), balls

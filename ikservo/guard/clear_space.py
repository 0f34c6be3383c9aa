"""The space of postures in which an arm keeps its clearances, for checks of many motions."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from ikservo.guard.sag import GravitySag
from ikservo.kernels.compiled import bind
from ikservo.kinematics.arrays import Matrix, Vector, finite_vectors
from ikservo.kinematics.packed import (
    CAPSULE_WIDTH,
    CENTRE,
    END,
    HALF,
    LINK,
    LINK_POSE,
    MIMIC_OFFSET,
    MIMIC_SCALE,
    PARENT,
    RADIUS,
    ROUNDING,
    START,
    PackedBody,
)

# Between postures this far apart, the links of a sagging arm are assumed to move on straight lines
# in joint space. Torques are sines of sums of joint positions: if three joints turn together and
# one yields by 0.1 rad, the links deviate from such a line by about 0.001 rad at most.
_BENDING_STEP_RAD = 0.1


class RigidBodies:
    """The rigid bodies of an arm: links without a joint between them share a frame.

    Attributes:
        frames: One row per body, in the format of link rows; see ``kinematics.packed``.
        capsules: The capsules in these frames, with frame numbers instead of link numbers.
        spheres: The sphere around each capsule, see ``first_contact``.
        balls: The spheres (links, 8) around the capsules of each link, with frame numbers.
        pairs: The two links of each pair, and its number (pairs, 3).
    """

    def __init__(self, body: PackedBody) -> None:
        frames, poses, numbers = list[Vector](), list[Matrix](), list[int]()
        for link in body.links:
            pose, parent = np.eye(4), int(link[PARENT])
            pose[:3, :3], pose[:3, 3] = link[:9].reshape(3, 3), link[LINK_POSE : LINK_POSE + 3]
            if parent >= 0:
                pose = poses[parent] @ pose
            is_fixed = parent >= 0 and link[MIMIC_SCALE] == 0.0 and link[MIMIC_OFFSET] == 0.0
            if not is_fixed:
                row = link.copy()
                row[:9], row[LINK_POSE : LINK_POSE + 3] = pose[:3, :3].ravel(), pose[:3, 3]
                row[PARENT] = numbers[parent] if parent >= 0 else -1
                frames.append(row)
            numbers.append(numbers[parent] if is_fixed else len(frames) - 1)
            poses.append(pose if is_fixed else np.eye(4))
        self.frames, self._poses, self._numbers = np.array(frames), np.array(poses), numbers
        of = body.capsules[:, LINK].astype(int)
        self.capsules = body.capsules.copy()
        for at in (START, END):
            points = body.capsules[:, at : at + 3, None]
            self.capsules[:, at : at + 3] = (self._poses[of, :3, :3] @ points)[..., 0]
            self.capsules[:, at : at + 3] += self._poses[of, :3, 3]
        self.capsules[:, LINK] = np.array(numbers)[of]
        from ikservo.kernels.free_path import SPHERE_ROWS  # noqa: PLC0415  # as in the checker

        starts, ends = self.capsules[:, START : START + 3], self.capsules[:, END : END + 3]
        self.spheres = np.zeros((SPHERE_ROWS, len(starts)))
        self.spheres[:3] = 0.5 * (starts + ends).T
        self.spheres[3] = 0.5 * np.linalg.norm(ends - starts, axis=1) + self.capsules[:, RADIUS]
        self.balls = self._balls(of)
        first = np.flatnonzero(np.diff(body.rows[:, 2], prepend=-1.0))
        rows = body.rows[first].astype(np.int64)
        self.pairs = np.column_stack([of[rows[:, :2]].astype(np.int64), rows[:, 2]])

    def masses(self, of_links: Matrix) -> Matrix:
        """Combine mass [kg] and centre [m] of the links (links, 4) into those of bodies (n, 4)."""
        centres = (self._poses[:, :3, :3] @ of_links[:, 1:, None])[..., 0] + self._poses[:, :3, 3]
        masses = np.zeros((len(self.frames), 4))
        np.add.at(masses[:, 0], self._numbers, of_links[:, 0])
        np.add.at(masses[:, 1:], self._numbers, of_links[:, :1] * centres)
        masses[:, 1:] /= np.where(masses[:, :1] > 0.0, masses[:, :1], 1.0)
        return masses

    def _balls(self, links: NDArray[np.intp]) -> Matrix:
        from ikservo.kernels.free_path import FIRST_CAPSULE, LAST_CAPSULE  # noqa: PLC0415

        balls = np.zeros((len(self._numbers), CAPSULE_WIDTH))
        balls[:, LINK] = self._numbers
        first = np.flatnonzero(np.diff(links, prepend=-1))  # a link's capsules are adjacent
        own, count = links[first], np.diff(first, append=len(links))
        starts, ends = self.capsules[:, START : START + 3], self.capsules[:, END : END + 3]
        low = np.minimum.reduceat(np.minimum(starts, ends), first)
        high = np.maximum.reduceat(np.maximum(starts, ends), first)
        balls[own, START : START + 3] = 0.5 * (low + high)
        balls[own, FIRST_CAPSULE], balls[own, LAST_CAPSULE] = first, first + count
        centres = np.repeat(0.5 * (low + high), count, axis=0)
        apart_m = [np.linalg.norm(points - centres, axis=1) for points in (starts, ends)]
        radii = np.maximum(*apart_m) + self.capsules[:, RADIUS]
        balls[own, RADIUS] = np.maximum.reduceat(radii, first)
        return balls


class ClearSpace:
    """The postures, and straight motions between them, in which an arm keeps its clearances.

    Motions are checked continuously, not only at samples: no distance falls short by a millimetre,
    even to thin obstacles. Only one thread at a time may use a space, which
    ``CollisionChecker.clear_space`` makes.

    Args:
        body: The arm.
        rigid: The rigid bodies of the arm.
        shapes: The obstacles (k, 17) other than the table; see ``kinematics.packed``.
        floor_m: The height of the table; minus infinity if there is no table.
        allowed_m: The distances (2, pairs) that capsules must keep: first row without sag, second
            row with sag.
        sag: The sag of the arm under gravity; None if it is not considered.
        load: Multiple of gravity under which the arm sags.
        bends: Computes the link joints (n, dof) from the sensor joints (n, dof); None if the arm
            does not bend between sensors and links.
        sampled_m: The distances (2, pairs) that searches must keep at their samples; None uses
            ``allowed_m``.

    Attributes:
        sampled: The arrays for the kernel with the distances of ``sampled_m``.
    """

    def __init__(
        self,
        body: PackedBody,
        rigid: RigidBodies,
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
        half_m = np.abs(shapes[:, :9].reshape(-1, 3, 3)) @ shapes[:, HALF : HALF + 3, None]
        grown_m = half_m[:, :, 0] + shapes[:, ROUNDING, None]
        # A box along the base axes around each obstacle: its centre and half its size (6, k).
        boxes = np.ascontiguousarray(np.hstack([shapes[:, CENTRE : CENTRE + 3], grown_m]).T)
        watched = allowed_m[0, : len(body.pairs)] > -np.inf
        arguments = (
            rigid.frames, rigid.capsules, rigid.spheres, rigid.balls, rigid.pairs[watched], shapes,
            boxes, floor_m,
            np.vstack([body.pair_reach_m, body.reach_m]),
            np.zeros((len(rigid.frames), 4)) if sag is None else rigid.masses(sag.masses),
            np.zeros((3, body.dof)) if sag is None else sag.bounds,
            np.empty((len(rigid.frames), 12)), np.empty((len(body.capsules), 6)),
            np.empty((links, 4)), np.empty((3, body.dof)), np.zeros(len(body.pairs) + links),
        )  # fmt: skip
        sampled_m = allowed_m if sampled_m is None else sampled_m
        load = 0.0 if sag is None else load
        kept_m, sampled_m = (
            _with_largest(each, links, len(shapes)) for each in (allowed_m, sampled_m)
        )
        self.sampled = (*arguments, sampled_m, load)
        self._first_contact = bind("first_contact", *arguments, kept_m, load)
        self._free_postures = bind("free_postures", *arguments, kept_m, load)

    def is_free(self, path: Matrix) -> bool:
        """Check whether the straight motions through postures (n, dof) keep the distances."""
        if self._bends is not None:
            pieces = [_close_postures(a, b) for a, b in itertools.pairwise(path)]
            path = self._bends(np.vstack([path[:1], *pieces]))
        # Without compiled kernels the comparison gives a NumPy bool, which OMPL does not accept.
        return bool(self._first_contact(path) == self._no_contact)

    def contains(self, postures: Matrix) -> NDArray[np.bool_]:
        """Check which postures (n, dof) keep the distances; return a mask (n,)."""
        q = finite_vectors(np.array(postures), self._dof, "q")
        if self._bends is not None:
            q = self._bends(q)
        free = np.zeros(len(q), dtype=np.int64)
        self._free_postures(q, free)
        return free == 1


def _close_postures(start: Vector, goal: Vector) -> Matrix:
    """Return closely spaced postures (k, dof) on the straight path to a goal, the last row."""
    count = max(1, math.ceil(float(np.abs(goal - start).max()) / _BENDING_STEP_RAD))
    return np.linspace(start, goal, count + 1)[1:]


def _with_largest(allowed_m: Matrix, links: int, shapes: int) -> Matrix:
    """Append, for each link, the largest of its allowed distances to obstacles (2, pairs)."""
    of_things = allowed_m[:, allowed_m.shape[1] - links * shapes :].reshape(2, shapes, links)
    return np.hstack([allowed_m, of_things.max(axis=1, initial=-np.inf)])

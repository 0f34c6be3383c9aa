"""Ray casting against the links of an arm and the things in a scene.

Each link has a box around its capsules. A ray is transformed into the frame of the link, so that
no shape has to be moved, and the capsules are only tested if the ray meets the box. All tests are
vectorised over rays and shapes; an arm has about 40 capsules.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.capsules import Capsule
from ikservo.model.arm_model import Obstacle

_PARALLEL = 1e-12
_CORNERS = np.array(list(np.ndindex(2, 2, 2)))


@dataclass(frozen=True, slots=True, eq=False)
class PickShape:
    """The capsules of a link and the box around them, or a thing of the scene: only a box.

    Attributes:
        box_m: Low and high corner of the box (2, 3), local coordinates, metres.
        capsules: Both ends and the radius of each capsule (n, 7), metres; empty for a thing.
    """

    box_m: Matrix
    capsules: Matrix = field(default_factory=lambda: np.empty((0, 7)))

    @property
    def corners_m(self) -> Matrix:
        """The corners of the box (8, 3), local coordinates, metres."""
        low, high = self.box_m
        return low + _CORNERS * (high - low)


def link_shapes(capsules: Sequence[Capsule]) -> dict[str, PickShape]:
    """Group the capsules by link."""
    links = dict[str, list[list[float]]]()
    for each in capsules:
        links.setdefault(each.link, []).append([*each.start_m, *each.end_m, each.radius_m])
    return {link: capsule_shape(np.array(rows)) for link, rows in links.items()}


def capsule_shape(capsules: Matrix) -> PickShape:
    """Make the shape of capsules: both ends and the radius of each (n, 7), metres."""
    ends, radii = capsules[:, :6].reshape(-1, 2, 3), capsules[:, 6, None]
    low = (ends.min(axis=1) - radii).min(axis=0)
    return PickShape(np.array([low, (ends.max(axis=1) + radii).max(axis=0)]), capsules)


def thing_shapes(things: Iterable[Obstacle]) -> dict[str, PickShape]:
    """Return the upright box around each thing, base frame."""
    return {each.name: PickShape(np.array([each.low_m, each.high_m])) for each in things}


def cast_rays(
    shapes: Mapping[str, PickShape],
    poses: Mapping[str, Matrix],
    origins: Matrix,
    directions: Matrix,
) -> Matrix:
    """Compute the distances (k, shapes) along rays to the front of each shape, metres.

    A distance is infinite if the ray misses the shape. A ray that starts inside a capsule misses
    it; one that starts inside a thing meets its wall.

    Args:
        shapes: The links and things, by name.
        poses: T_world_link (4, 4) of each name.
        origins: The start of each ray (k, 3), world.
        directions: Unit vectors (k, 3), world.
    """
    T = np.array([poses[name] for name in shapes]).reshape(-1, 4, 4)
    R_link_world = T[:, :3, :3].swapaxes(1, 2)
    origins_link = R_link_world @ (origins.T - T[:, :3, 3:])  # (shapes, 3, k)
    directions_link = R_link_world @ directions.T
    boxes = np.array([shape.box_m for shape in shapes.values()]).reshape(-1, 2, 3, 1)
    distances = _box_distances(origins_link, directions_link, boxes[:, 0], boxes[:, 1])
    for link, shape in enumerate(shapes.values()):
        met = np.flatnonzero(np.isfinite(distances[link]))
        if len(shape.capsules) and len(met):
            distances[link, met] = _capsule_distances(
                origins_link[link, :, met], directions_link[link, :, met], shape.capsules
            )
    return distances.T


def _box_distances(origins: Matrix, directions: Matrix, low: Matrix, high: Matrix) -> Matrix:
    """Compute the distances (n, k) along rays (n, 3, k) to boxes; if inside, to the wall."""
    along = np.where(np.abs(directions) < _PARALLEL, _PARALLEL, directions)
    one, other = (low - origins) / along, (high - origins) / along
    enter_m: Matrix = np.minimum(one, other).max(axis=1)
    leave_m: Matrix = np.maximum(one, other).min(axis=1)
    ahead_m = np.where(enter_m >= 0.0, enter_m, leave_m)
    return np.where((enter_m <= leave_m) & (leave_m >= 0.0), ahead_m, np.inf)


def _capsule_distances(origins: Matrix, directions: Matrix, capsules: Matrix) -> Vector:
    """Compute the distance (k,) along each ray (k, 3) to the first of the capsules (n, 7).

    The side solves |o + t d - (a + s b)| = r with 0 < s < 1, and the spheres at both ends solve it
    with s = 0 and s = 1. Each is NaN if the line misses it. A capsule is convex, so the line enters
    it where it enters the first of the three.
    """
    a, b, radius = capsules[:, :3], capsules[:, 3:6] - capsules[:, :3], capsules[:, 6]
    o = origins[:, None] - a
    bb, bd, bo = np.einsum("ni,ni->n", b, b), directions @ b.T, np.einsum("kni,ni->kn", o, b)
    do, oo = np.einsum("kni,ki->kn", o, directions), np.einsum("kni,kni->kn", o, o) - radius**2
    A, B, C = bb - bd * bd, bb * do - bo * bd, bb * oo - bo * bo
    with np.errstate(invalid="ignore"):
        side = (-B - np.sqrt(B * B - A * C)) / np.where(_PARALLEL * bb < A, A, np.nan)
        along = bo + side * bd
        side[~((along > 0.0) & (along < bb))] = np.nan
        start = -do - np.sqrt(do * do - oo)
        end = bd - do - np.sqrt((do - bd) ** 2 - (oo - 2.0 * bo + bb))
    enter_m = np.fmin(side, np.fmin(start, end))
    return np.where(enter_m >= 0.0, enter_m, np.inf).min(axis=1)

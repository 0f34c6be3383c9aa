"""What is under the pointer: the links near a pixel, the nearest first (lecture L15 to L18).

Boxes of links, moved with the arm, stand over trees of boxes in link coordinates, which never
change: the ray is taken into the link instead of the link to the ray. A pointer means a small
square of pixels, with a ray through the middle of each::

    picker = Picker(shapes_of(capsules_of(model)))
    hits = picker.all_at(camera, link_poses(chain, q, {}), px)     # by depth
    hit = picker.at(camera, link_poses(chain, q, {}), px)          # None over empty space
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.view.camera.camera import Camera
from ikservo.view.pick.boxes import plant

__all__ = ["REGION_PX", "Hit", "Picker"]

REGION_PX = 5
"""The side of the square around the pointer, in pixels (lecture L17)."""


@dataclass(frozen=True, slots=True, eq=False)
class Hit:
    """A link that a pointer means.

    Attributes:
        link: Its name.
        offset_m: The point that was hit (3,), link coordinates, metres.
        point_m: The same point (3,), world coordinates.
        depth_m: How deep in the picture it is.
        away_px: How far from the pointer itself; 0 where the pointer is right over the link.
        shape: Which of the link's shapes it belongs to.
    """

    link: str
    offset_m: Vector
    point_m: Vector
    depth_m: float
    away_px: float
    shape: int


class Picker:
    """Finds links by pixels.

    Args:
        shapes: The primitives (n, WIDTH) of each link, link coordinates; see ``shapes``.
    """

    def __init__(self, shapes: Mapping[str, Matrix]) -> None:
        self._forest = plant(shapes)
        roots = self._forest.boxes[self._forest.roots]
        self._middles = 0.5 * (roots[:, :3] + roots[:, 3:])
        self._halves = 0.5 * (roots[:, 3:] - roots[:, :3])
        self.looked = 0

    def at(
        self,
        camera: Camera,
        poses: Mapping[str, Matrix],
        px: ArrayLike,
        region_px: int = REGION_PX,
    ) -> Hit | None:
        """Return the nearest link right under the pixel (2,), else the nearest close to it."""
        hits = self.all_at(camera, poses, px, region_px)
        return min(hits, key=lambda hit: (hit.away_px > 0.0, hit.depth_m), default=None)

    def all_at(
        self,
        camera: Camera,
        poses: Mapping[str, Matrix],
        px: ArrayLike,
        region_px: int = REGION_PX,
    ) -> tuple[Hit, ...]:
        """Return every link in the square around a pixel (2,), the nearest first.

        Args:
            camera: What the person sees.
            poses: T_world_link (4, 4) of each link.
            px: Where the pointer is, CSS pixels.
            region_px: The side of the square, an odd number of pixels.
        """
        offsets = _square(region_px)
        origins, directions = camera.rays(np.asarray(px, dtype=np.float64) + offsets)
        ways, rows = self.cast(origins, directions, poses)
        hits: list[Hit] = []
        for i, link in enumerate(self._forest.links):
            rays = np.flatnonzero(np.isfinite(ways[:, i]))
            if len(rays):  # the first is the closest to the pointer
                ray = int(rays[0])
                point = origins[ray] + ways[ray, i] * directions[ray]
                away_px, row = float(np.hypot(*offsets[ray])), int(rows[ray, i])
                hits.append(self._hit(camera, link, poses[link], point, away_px, row))
        return tuple(sorted(hits, key=lambda hit: hit.depth_m))

    def cast(
        self, origins: Matrix, directions: Matrix, poses: Mapping[str, Matrix]
    ) -> tuple[Matrix, NDArray[np.int64]]:
        """Return how far rays (k, 3) go to each link (k, links), and the rows they meet."""
        from ikservo.view.pick.casting import cast  # noqa: PLC0415  # numba loads for a second

        forest = self._forest
        T = np.array([poses[link] for link in forest.links]).reshape(-1, 4, 4)
        R = np.ascontiguousarray(T[:, :3, :3])
        places = np.ascontiguousarray(T[:, :3, 3])
        ways = np.empty((len(origins), len(forest.links)))
        rows = np.empty(ways.shape, dtype=np.int64)
        self.looked = cast(
            np.ascontiguousarray(origins), np.ascontiguousarray(directions), R.reshape(-1, 9),
            places, self._around(R, places), forest.roots, forest.boxes, forest.nodes,
            forest.rows, ways, rows,
        )  # fmt: skip
        return ways, rows

    def _around(self, R: Matrix, places: Matrix) -> Matrix:
        """Return the upright boxes (links, 6) around the links where they are now."""
        middles = np.einsum("lij,lj->li", R, self._middles) + places
        halves = np.einsum("lij,lj->li", np.abs(R), self._halves)
        return np.hstack([middles - halves, middles + halves])

    def _hit(
        self,
        camera: Camera,
        link: str,
        T_world_link: Matrix,
        point_m: Vector,
        away_px: float,
        row: int,
    ) -> Hit:
        return Hit(
            link=link,
            offset_m=T_world_link[:3, :3].T @ (point_m - T_world_link[:3, 3]),
            point_m=point_m,
            depth_m=float(camera.depth_of(point_m)),
            away_px=away_px,
            shape=int(self._forest.names[row]),
        )


def _square(side_px: int) -> Matrix:
    """Return the middles (n, 2) of a square of pixels around its own, the closest first."""
    half = max(0, side_px // 2)
    steps = np.arange(-half, half + 1, dtype=np.float64)
    offsets = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    return offsets[np.argsort(np.hypot(*offsets.T), kind="stable")]

"""What is under the pointer: the links near a pixel, the nearest first (lecture L15 to L18).

Boxes of links, moved with the arm, stand over trees of boxes in link coordinates, which never
change: the ray is taken into the link instead of the link to the ray. A pointer means a small
square of pixels; every link that falls in it is a hit, however thin it is (see ``region``)::

    picker = Picker(shapes_of(capsules_of(model)))
    hits = picker.all_at(camera, link_poses(chain, q, {}), px)     # by depth
    hit = picker.at(camera, link_poses(chain, q, {}), px)          # None over empty space
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
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
        away_px: Half the side of the smallest square about the pointer that the link falls in; 0
            where the pointer is right over it.
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

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of what can be found."""
        return self._forest.links

    def at(
        self,
        camera: Camera,
        poses: Mapping[str, Matrix],
        px: ArrayLike,
        region_px: float = REGION_PX,
    ) -> Hit | None:
        """Return the nearest link right under the pixel (2,), else the nearest close to it."""
        hits = self.all_at(camera, poses, px, region_px)
        return min(hits, key=lambda hit: (hit.away_px > 0.0, hit.depth_m), default=None)

    def all_at(
        self,
        camera: Camera,
        poses: Mapping[str, Matrix],
        px: ArrayLike,
        region_px: float = REGION_PX,
    ) -> tuple[Hit, ...]:
        """Return every link in the square around a pixel (2,), the nearest first.

        Args:
            camera: What the person sees.
            poses: T_world_link (4, 4) of each link.
            px: Where the pointer is, CSS pixels.
            region_px: The side of the square; with 0 only what is right under the pointer.
        """
        at = np.asarray(px, dtype=np.float64)
        hits = self._under(camera, poses, at)
        hits |= {
            link: hit
            for link, hit in self._beside(camera, poses, at, 0.5 * region_px).items()
            if link not in hits
        }
        return tuple(sorted(hits.values(), key=lambda hit: hit.depth_m))

    def _under(self, camera: Camera, poses: Mapping[str, Matrix], at: Vector) -> dict[str, Hit]:
        """Return what the line of sight through the pointer meets, by link."""
        (origin,), (direction,) = origins, directions = camera.rays(at[None])
        (ways,), (rows,) = self.cast(origins, directions, poses)
        return {
            link: self._hit(camera, link, poses[link], origin + way * direction, 0.0, int(row))
            for link, way, row in zip(self._forest.links, ways, rows, strict=True)
            if np.isfinite(way)
        }

    def _beside(
        self, camera: Camera, poses: Mapping[str, Matrix], at: Vector, half_px: float
    ) -> dict[str, Hit]:
        """Return what falls in the square around the pointer, by link."""
        from ikservo.view.pick.region import (  # noqa: PLC0415  # numba loads for a second
            AWAY,
            DEPTH,
            RIGHT,
            ROW,
            UP,
            find_in_square,
        )  # fmt: skip

        forest, hits = self._forest, dict[str, Hit]()
        if half_px <= 0.0:
            return hits
        found = np.empty((len(forest.links), 5))
        pointer = (at - camera.viewport.centre_px) * (1.0, -1.0) / camera.scale_px
        eye = np.array([*pointer, float(camera.perspective)])
        T_view_link = _seen_from(camera, [poses[link] for link in forest.links])
        half = half_px / camera.scale_px
        self.looked = find_in_square(
            T_view_link, eye, half, forest.roots, forest.boxes, forest.nodes, forest.rows, found
        )
        for link, seen in zip(forest.links, found, strict=True):
            if np.isfinite(seen[AWAY]):
                away_px = camera.scale_px * seen[[RIGHT, UP]] * (1.0, -1.0)
                point = camera.unproject(at + away_px, seen[DEPTH])
                px = float(camera.scale_px * seen[AWAY])
                hits[link] = self._hit(camera, link, poses[link], point, px, int(seen[ROW]))
        return hits

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


def _seen_from(camera: Camera, poses: Sequence[Matrix]) -> Matrix:
    """Return rotations and origins (links, 12) of links: right, up and depth from the eye."""
    T = np.array(poses).reshape(-1, 4, 4)
    R_view = camera.R_world_view.T * [[1.0], [1.0], [-1.0]]
    R = (R_view @ T[:, :3, :3]).reshape(-1, 9)
    places = (T[:, :3, 3] - camera.eye_m) @ R_view.T
    return np.ascontiguousarray(np.hstack([R, places]))

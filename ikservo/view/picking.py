"""Picking: links, objects and joints near the pointer, the nearest first.

Boxes of links, moved with the arm, stand over trees of boxes in link coordinates, which never
change: the ray is taken into the link instead of the link to the ray. A pointer means a small
square of pixels; every link that falls in it is a hit, however thin it is (see ``region``)::

    picker = Picker(shapes_of(capsules_of(model)))
    hits = picker.all_at(camera, link_poses(chain, q, {}), px)     # by depth
    hit = picker.at(camera, link_poses(chain, q, {}), px)          # None over empty space
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.view.bvh import build_bvh
from ikservo.view.camera import Camera
from ikservo.view.draw_items import link_poses
from ikservo.view.joint_arcs import JointDial, joint_dials

__all__ = ["PICK_TOLERANCE_PX", "Hit", "HitTester", "PickCandidate", "Picker", "PointerContext"]


PICK_TOLERANCE_PX = 5
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
        self._forest = build_bvh(shapes)
        roots = self._forest.boxes[self._forest.roots]
        self._middles = 0.5 * (roots[:, :3] + roots[:, 3:])
        self._halves = 0.5 * (roots[:, 3:] - roots[:, :3])
        self.looked = 0

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of what can be found."""
        return self._forest.links

    def pick_at(
        self,
        camera: Camera,
        poses: Mapping[str, Matrix],
        px: ArrayLike,
        region_px: float = PICK_TOLERANCE_PX,
    ) -> Hit | None:
        """Return the nearest link right under the pixel (2,), else the nearest close to it."""
        hits = self.pick_all_at(camera, poses, px, region_px)
        return min(hits, key=lambda hit: (hit.away_px > 0.0, hit.depth_m), default=None)

    def pick_all_at(
        self,
        camera: Camera,
        poses: Mapping[str, Matrix],
        px: ArrayLike,
        region_px: float = PICK_TOLERANCE_PX,
    ) -> tuple[Hit, ...]:
        """Return every link in the square around a pixel (2,), the nearest first.

        Args:
            camera: What the person sees.
            poses: T_world_link (4, 4) of each link.
            px: Where the pointer is, CSS pixels.
            region_px: The side of the square; with 0 only what is right under the pointer.
        """
        at = np.asarray(px, dtype=np.float64)
        hits = self._hits_under(camera, poses, at)
        hits |= {
            link: hit
            for link, hit in self._hits_beside(camera, poses, at, 0.5 * region_px).items()
            if link not in hits
        }
        return tuple(sorted(hits.values(), key=lambda hit: hit.depth_m))

    def _hits_under(
        self, camera: Camera, poses: Mapping[str, Matrix], at: Vector
    ) -> dict[str, Hit]:
        """Return what the line of sight through the pointer meets, by link."""
        (origin,), (direction,) = origins, directions = camera.rays(at[None])
        (ways,), (rows,) = self.cast(origins, directions, poses)
        return {
            link: self._make_hit(camera, link, poses[link], origin + way * direction, 0.0, int(row))
            for link, way, row in zip(self._forest.links, ways, rows, strict=True)
            if np.isfinite(way)
        }

    def _hits_beside(
        self, camera: Camera, poses: Mapping[str, Matrix], at: Vector, half_px: float
    ) -> dict[str, Hit]:
        """Return what falls in the square around the pointer, by link."""
        from ikservo.view.pick_region import (  # noqa: PLC0415  # loads when first used
            AWAY,
            DEPTH,
            RIGHT,
            ROW,
            UP,
            find_in_square,
        )

        forest, hits = self._forest, dict[str, Hit]()
        if half_px <= 0.0:
            return hits
        found = np.empty((len(forest.links), 5))
        pointer = (at - camera.viewport.centre_px) * (1.0, -1.0) / camera.scale_px
        eye = np.array([*pointer, float(camera.perspective)])
        T_view_link = _view_transforms(camera, [poses[link] for link in forest.links])
        half = half_px / camera.scale_px
        self.looked = find_in_square(
            T_view_link, eye, half, forest.roots, forest.boxes, forest.nodes, forest.rows, found
        )
        for link, seen in zip(forest.links, found, strict=True):
            if np.isfinite(seen[AWAY]):
                away_px = camera.scale_px * seen[[RIGHT, UP]] * (1.0, -1.0)
                point = camera.unproject(at + away_px, seen[DEPTH])
                px = float(camera.scale_px * seen[AWAY])
                hits[link] = self._make_hit(camera, link, poses[link], point, px, int(seen[ROW]))
        return hits

    def cast(
        self, origins: Matrix, directions: Matrix, poses: Mapping[str, Matrix]
    ) -> tuple[Matrix, NDArray[np.int64]]:
        """Return how far rays (k, 3) go to each link (k, links), and the rows they meet."""
        from ikservo.view.raycast import raycast  # noqa: PLC0415  # loads when first used

        forest = self._forest
        T = np.array([poses[link] for link in forest.links]).reshape(-1, 4, 4)
        R = np.ascontiguousarray(T[:, :3, :3])
        places = np.ascontiguousarray(T[:, :3, 3])
        ways = np.empty((len(origins), len(forest.links)))
        rows = np.empty(ways.shape, dtype=np.int64)
        self.looked = raycast(
            np.ascontiguousarray(origins), np.ascontiguousarray(directions), R.reshape(-1, 9),
            places, self._world_boxes(R, places), forest.roots, forest.boxes, forest.nodes,
            forest.rows, ways, rows,
        )  # fmt: skip
        return ways, rows

    def _world_boxes(self, R: Matrix, places: Matrix) -> Matrix:
        """Return the upright boxes (links, 6) around the links where they are now."""
        middles = np.einsum("lij,lj->li", R, self._middles) + places
        halves = np.einsum("lij,lj->li", np.abs(R), self._halves)
        return np.hstack([middles - halves, middles + halves])

    def _make_hit(
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


def _view_transforms(camera: Camera, poses: Sequence[Matrix]) -> Matrix:
    """Return rotations and origins (links, 12) of links: right, up and depth from the eye."""
    T = np.array(poses).reshape(-1, 4, 4)
    R_view = camera.R_world_view.T * [[1.0], [1.0], [-1.0]]
    R = (R_view @ T[:, :3, :3]).reshape(-1, 9)
    places = (T[:, :3, 3] - camera.eye_m) @ R_view.T
    return np.ascontiguousarray(np.hstack([R, places]))


_HUB_PX, _NEAR_PX = 10.0, 30.0
_SAME_RAD = 2e-3


@dataclass(frozen=True, slots=True, eq=False)
class PointerContext:
    """What the person has before them when an event happens.

    Attributes:
        camera: Where they look from.
        arms: Joints (dof,) of the arms that are drawn: the goal first, if there is one, then
            the measured arm. The first is the one that moves.
        plane_m: A point (3,) of the plane the view shows, where clicks on nothing go; that of
            the tip if None.
        beside: Positions of joints beside the way to the tip.
    """

    camera: Camera
    arms: tuple[Vector, ...]
    plane_m: Vector | None = None
    beside: Mapping[str, float] = field(default_factory=dict[str, float])


class PickCandidate(NamedTuple):
    """Something under the pointer.

    Attributes:
        hit: Where.
        kind: ``link`` that q moves, ``fixed`` link, or ``object`` of the scene.
        q: Joints (dof,) of the arm that it belongs to; None for an object.
    """

    hit: Hit
    kind: Literal["link", "fixed", "object"]
    q: Vector | None


class HitTester:
    """Finds links, objects and joints by pixels.

    Args:
        chain: The arm.
        picker: Finds its links.
        objects: Finds the objects of the scene, in the base frame; None for none.
    """

    def __init__(self, chain: Chain, picker: Picker, objects: Picker | None = None) -> None:
        self._chain, self._picker, self._objects = chain, picker, objects
        self._dials = {dial.column: dial for dial in joint_dials(chain, chain.mid_range())}

    def candidates_at(self, at: Vector, sight: PointerContext) -> tuple[PickCandidate, ...]:
        """Return all that is under the pointer, what a press grabs first, then what is behind.

        Links that move come first, those of the goal before those of the arm, which is painted
        below it; then objects, then links that stand still. Of each kind what is right under the
        pointer is before what is beside it, and the nearest first.
        """
        layers = [self._link_candidates(at, sight, q) for q in _drop_coincident_arms(sight.arms)]
        moving = [found for layer in layers for found in layer if found.kind == "link"]
        fixed = [found for found in layers[-1] if found.kind == "fixed"]
        ordered = [
            *sorted(moving, key=_is_beside_pointer),
            *self._object_candidates(at, sight),
            *fixed,
        ]
        return tuple(ordered)

    def _link_candidates(self, at: Vector, sight: PointerContext, q: Vector) -> list[PickCandidate]:
        hits = self._picker.pick_all_at(sight.camera, link_poses(self._chain, q, sight.beside), at)
        found = [
            PickCandidate(hit, "link" if self.columns(hit.link) else "fixed", q) for hit in hits
        ]
        return sorted(found, key=_is_beside_pointer)

    def _object_candidates(self, at: Vector, sight: PointerContext) -> list[PickCandidate]:
        if self._objects is None:
            return []
        still = dict.fromkeys(self._objects.names, np.eye(4))
        hits = self._objects.pick_all_at(sight.camera, still, at)
        return sorted((PickCandidate(hit, "object", None) for hit in hits), key=_is_beside_pointer)

    def joint_at(
        self, at: Vector, sight: PointerContext, found: PickCandidate | None
    ) -> JointDial | None:
        """Return the joint whose hub is under the pointer, else the one that moves the link."""
        poses, q = self.poses(sight), sight.arms[0]
        hubs_m = np.array([dial.hub(poses, q) for dial in self._dials.values()])
        away_px = np.hypot(*(sight.camera.project(hubs_m)[0] - at).T)
        nearest = int(np.argmin(away_px))
        if away_px[nearest] <= (_HUB_PX if found else _NEAR_PX):
            return list(self._dials.values())[nearest]
        return self._dials[self.columns(found.hit.link)[-1]] if found else None

    def poses(self, sight: PointerContext) -> dict[str, Matrix]:
        """Return T_world_link (4, 4) of every link of the arm that moves."""
        return link_poses(self._chain, sight.arms[0], sight.beside)

    def columns(self, link: str) -> list[int]:
        """Return the entries of q that move a link, base to tip."""
        return [step.column for step in self._chain.joints_to(link) if step.scale]


def _is_beside_pointer(found: PickCandidate) -> bool:
    """Return whether it is beside the pointer: a stable sort leaves the rest by depth."""
    return found.hit.away_px > 0.0


def _drop_coincident_arms(arms: Sequence[Vector]) -> list[Vector]:
    """Return arms without those that stand where one before them does."""
    kept = list[Vector]()
    for q in arms:
        if not any(float(np.abs(q - other).max()) < _SAME_RAD for other in kept):
            kept.append(q)
    return kept

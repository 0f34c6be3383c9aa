"""Picking: links, objects and joints near the pointer, the nearest first.

The bounding box of each link moves with the arm; below it is a tree of boxes in link coordinates,
which never changes: rays are transformed into the link. A pointer covers a small square of pixels;
every link in it is a hit, however thin it is (see ``pick_region``)::

    picker = Picker(link_primitives(capsules_of(model)))
    hits = picker.pick_all_at(camera, link_poses(chain, q, {}), px)     # by depth
    hit = picker.pick_at(camera, link_poses(chain, q, {}), px)          # None over empty space
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ikservo.apps.page.picking.bvh import build_bvh
from ikservo.apps.page.picking.joint_dials import JointDial, joint_dials
from ikservo.apps.page.picking.lens_camera import PictureSurface
from ikservo.apps.page.picking.link_poses import link_poses
from ikservo.apps.page.picking.projection import Camera
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector

PICK_TOLERANCE_PX = 5
"""The side of the square around the pointer, in pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class Hit:
    """A link near the pointer.

    Attributes:
        link: Its name.
        offset_m: The hit point (3,), link coordinates, metres.
        point_m: The same point (3,), world coordinates.
        depth_m: Its depth.
        away_px: Half the side of the smallest square around the pointer that contains the link; 0
            if the pointer is right over it.
        shape: Index of the hit shape of the link.
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
        shapes: The primitives (n, ROW_WIDTH) of each link, link coordinates; see ``bvh``.

    Attributes:
        tested: The number of shapes that the last search tested.
    """

    def __init__(self, shapes: Mapping[str, Matrix]) -> None:
        self._forest = build_bvh(shapes)
        roots = self._forest.boxes[self._forest.roots]
        self._middles = 0.5 * (roots[:, :3] + roots[:, 3:])
        self._halves = 0.5 * (roots[:, 3:] - roots[:, :3])
        self.tested = 0

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the links."""
        return self._forest.links

    def pick_at(
        self,
        camera: Camera,
        poses: Mapping[str, Matrix],
        px: ArrayLike,
        region_px: float = PICK_TOLERANCE_PX,
    ) -> Hit | None:
        """Pick the nearest link right under the pixel (2,), else the nearest close to it."""
        hits = self.pick_all_at(camera, poses, px, region_px)
        return min(hits, key=lambda hit: (hit.away_px > 0.0, hit.depth_m), default=None)

    def pick_all_at(
        self,
        camera: Camera,
        poses: Mapping[str, Matrix],
        px: ArrayLike,
        region_px: float = PICK_TOLERANCE_PX,
    ) -> tuple[Hit, ...]:
        """Pick every link in the square around a pixel (2,), the nearest first.

        Args:
            camera: The user's camera.
            poses: T_world_link (4, 4) of each link.
            px: Position of the pointer, CSS pixels.
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
        """Return the hits of the line of sight through the pointer, by link."""
        (origin,), (direction,) = origins, directions = camera.rays(at[None])
        (distances,), (rows,) = self.cast(origins, directions, poses)
        return {
            link: self._make_hit(
                camera, link, poses[link], origin + distance * direction, 0.0, int(row)
            )
            for link, distance, row in zip(self._forest.links, distances, rows, strict=True)
            if np.isfinite(distance)
        }

    def _hits_beside(
        self, camera: Camera, poses: Mapping[str, Matrix], at: Vector, half_px: float
    ) -> dict[str, Hit]:
        """Return the hits in the square around the pointer, by link."""
        from ikservo.apps.page.picking.pick_region import (  # noqa: PLC0415  # loads when first used
            DEPTH,
            OFFSET,
            RIGHT,
            ROW,
            UP,
            find_in_square,
        )

        forest, hits = self._forest, dict[str, Hit]()
        if half_px <= 0.0:
            return hits
        found = np.empty((len(forest.links), 5))
        right_up = camera.across_px(at) * (1.0, -1.0) / camera.scale_px
        pointer = np.array([*right_up, float(camera.perspective)])
        T_view_link = _view_transforms(camera, [poses[link] for link in forest.links])
        half = half_px / camera.scale_px
        self.tested = find_in_square(
            T_view_link, pointer, half, forest.roots, forest.boxes, forest.nodes, forest.rows, found
        )
        for link, nearest in zip(forest.links, found, strict=True):
            if np.isfinite(nearest[OFFSET]):
                away_px = camera.scale_px * nearest[[RIGHT, UP]] * (1.0, -1.0)
                point = camera.unproject(at + away_px, nearest[DEPTH])
                px = float(camera.scale_px * nearest[OFFSET])
                hits[link] = self._make_hit(camera, link, poses[link], point, px, int(nearest[ROW]))
        return hits

    def cast(
        self, origins: Matrix, directions: Matrix, poses: Mapping[str, Matrix]
    ) -> tuple[Matrix, NDArray[np.int64]]:
        """Compute the distances of rays (k, 3) to each link (k, links), and the rows they hit."""
        from ikservo.apps.page.picking.raycast import raycast  # noqa: PLC0415  # loads when first used

        forest = self._forest
        T = np.array([poses[link] for link in forest.links]).reshape(-1, 4, 4)
        R = np.ascontiguousarray(T[:, :3, :3])
        origins_link = np.ascontiguousarray(T[:, :3, 3])
        distances = np.empty((len(origins), len(forest.links)))
        rows = np.empty(distances.shape, dtype=np.int64)
        self.tested = raycast(
            np.ascontiguousarray(origins), np.ascontiguousarray(directions), R.reshape(-1, 9),
            origins_link, self._world_boxes(R, origins_link), forest.roots, forest.boxes,
            forest.nodes, forest.rows, distances, rows,
        )  # fmt: skip
        return distances, rows

    def _world_boxes(self, R: Matrix, origins_link: Matrix) -> Matrix:
        """Compute the axis-aligned boxes (links, 6) of the links at their poses."""
        middles = np.einsum("lij,lj->li", R, self._middles) + origins_link
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
    origins_link = (T[:, :3, 3] - camera.eye_m) @ R_view.T
    return np.ascontiguousarray(np.hstack([R, origins_link]))


_HUB_PX, _NEAR_PX = 10.0, 30.0
_SAME_RAD = 2e-3


@dataclass(frozen=True, slots=True, eq=False)
class PointerContext:
    """What the user sees at the time of an event.

    Attributes:
        camera: The user's camera.
        arms: Joints (dof,) of the drawn arms: the goal first, if there is one, then the measured
            arm. The first is the one that moves.
        plane_m: A point (3,) of the plane for clicks on nothing; that of the tip if None.
        other_joints: Positions of joints that are not in the chain to the tip.
        surface: The surface for clicks on nothing in the picture of a calibrated camera.
    """

    camera: Camera
    arms: tuple[Vector, ...]
    plane_m: Vector | None = None
    other_joints: Mapping[str, float] = field(default_factory=dict[str, float])
    surface: PictureSurface | None = None


class PickCandidate(NamedTuple):
    """Something under the pointer.

    Attributes:
        hit: The hit.
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

    def set_objects(self, objects: Picker) -> None:
        """Find other objects of the scene from now on."""
        self._objects = objects

    def candidates_at(self, at: Vector, context: PointerContext) -> tuple[PickCandidate, ...]:
        """Return everything under the pointer, in the order in which presses select it.

        Links that move come first, those of the goal before those of the arm, which is painted
        below it; then objects, then fixed links. Within each kind, hits right under the pointer
        come before those beside it, and the nearest first.
        """
        layers = [
            self._link_candidates(at, context, q) for q in _drop_coincident_arms(context.arms)
        ]
        moving = [found for layer in layers for found in layer if found.kind == "link"]
        fixed = [found for found in layers[-1] if found.kind == "fixed"]
        ordered = [
            *sorted(moving, key=_is_beside_pointer),
            *self._object_candidates(at, context),
            *fixed,
        ]
        return tuple(ordered)

    def _link_candidates(
        self, at: Vector, context: PointerContext, q: Vector
    ) -> list[PickCandidate]:
        hits = self._picker.pick_all_at(
            context.camera, link_poses(self._chain, q, context.other_joints), at
        )
        found = [
            PickCandidate(hit, "link" if self.columns(hit.link) else "fixed", q) for hit in hits
        ]
        return sorted(found, key=_is_beside_pointer)

    def _object_candidates(self, at: Vector, context: PointerContext) -> list[PickCandidate]:
        if self._objects is None:
            return []
        poses = dict.fromkeys(self._objects.names, np.eye(4))
        hits = self._objects.pick_all_at(context.camera, poses, at)
        return sorted((PickCandidate(hit, "object", None) for hit in hits), key=_is_beside_pointer)

    def joint_at(
        self, at: Vector, context: PointerContext, found: PickCandidate | None
    ) -> JointDial | None:
        """Compute the joint whose hub is under the pointer, else the one that moves the link."""
        poses, q = self.poses(context), context.arms[0]
        hubs_m = np.array([dial.hub(poses, q) for dial in self._dials.values()])
        away_px = np.hypot(*(context.camera.project(hubs_m)[0] - at).T)
        nearest = int(np.argmin(away_px))
        if away_px[nearest] <= (_HUB_PX if found else _NEAR_PX):
            return list(self._dials.values())[nearest]
        return self._dials[self.columns(found.hit.link)[-1]] if found else None

    def poses(self, context: PointerContext) -> dict[str, Matrix]:
        """Return T_world_link (4, 4) of every link of the arm that moves."""
        return link_poses(self._chain, context.arms[0], context.other_joints)

    def columns(self, link: str) -> list[int]:
        """Return the entries of q that move a link, base to tip."""
        return [step.column for step in self._chain.joints_to(link) if step.scale]


def _is_beside_pointer(found: PickCandidate) -> bool:
    """Check whether a hit is beside the pointer; a stable sort by this keeps the depth order."""
    return found.hit.away_px > 0.0


def _drop_coincident_arms(arms: Sequence[Vector]) -> list[Vector]:
    """Compute the arms without those that coincide with an earlier one."""
    kept = list[Vector]()
    for q in arms:
        if not any(float(np.abs(q - other).max()) < _SAME_RAD for other in kept):
            kept.append(q)
    return kept

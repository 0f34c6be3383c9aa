"""Picking: links, objects and joints near the pointer, the nearest first.

A pointer covers a small square of pixels; every link that a line of sight through it meets is a
hit. The lines are at most a pixel apart, so that they find everything a pixel wide::

    picker = Picker(link_shapes(capsules_of(model)))
    hits = picker.pick_all_at(camera, link_poses(chain, q, {}), px)     # by depth
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ikservo.apps.page.picking.joint_dials import JointDial, joint_dials
from ikservo.apps.page.picking.lens_camera import PictureSurface
from ikservo.apps.page.picking.link_poses import link_poses
from ikservo.apps.page.picking.projection import Camera
from ikservo.apps.page.picking.raycast import PickShape, cast_rays
from ikservo.kinematics import Chain
from ikservo.kinematics.arrays import Matrix, Vector

PICK_TOLERANCE_PX = 5
"""The side of the square around the pointer, in pixels."""


@dataclass(frozen=True, slots=True, eq=False)
class Hit:
    """A link near the pointer.

    Attributes:
        link: The link name.
        offset_m: The hit point (3,), link coordinates, metres.
        point_m: The same point (3,), world coordinates.
        depth_m: The depth of the point, metres.
        away_px: The larger of the horizontal and vertical distances from the pointer; 0 if the
            pointer is directly over the link.
    """

    link: str
    offset_m: Vector
    point_m: Vector
    depth_m: float
    away_px: float


class Picker:
    """Picker of links, or objects of the scene, at pixels, by their shapes."""

    def __init__(self, shapes: Mapping[str, PickShape]) -> None:
        self._shapes = shapes

    @property
    def names(self) -> tuple[str, ...]:
        """The names of the links."""
        return tuple(self._shapes)

    def pick_all_at(
        self,
        camera: Camera,
        poses: Mapping[str, Matrix],
        px: ArrayLike,
        region_px: float = PICK_TOLERANCE_PX,
    ) -> tuple[Hit, ...]:
        """Pick every link in the square around a pixel (2,), the nearest first.

        ``poses`` has T_world_link (4, 4) of each link. The square has sides of ``region_px`` CSS
        pixels; 0: only things exactly under the pointer.
        """
        offsets_px = _square_offsets(region_px)
        origins, directions = camera.rays(np.asarray(px, dtype=np.float64) + offsets_px)
        distances = cast_rays(self._shapes, poses, origins, directions)
        away_px, hits = np.abs(offsets_px).max(axis=1), list[Hit]()
        for name, along_m in zip(self._shapes, distances.T, strict=True):
            met = np.flatnonzero(np.isfinite(along_m))
            if not len(met):
                continue
            ray = met[np.lexsort((along_m[met], away_px[met]))[0]]
            point_m = origins[ray] + along_m[ray] * directions[ray]
            offset_m = poses[name][:3, :3].T @ (point_m - poses[name][:3, 3])
            depth_m = float(camera.depth_of(point_m))
            hits.append(Hit(name, offset_m, point_m, depth_m, float(away_px[ray])))
        return tuple(sorted(hits, key=lambda hit: hit.depth_m))


@cache
def _square_offsets(side_px: float) -> Matrix:
    """Compute a grid of offsets (k, 2) over a square, with its middle, at most a pixel apart."""
    count = max(math.ceil(0.5 * side_px), 1)
    line_px = 0.5 * side_px * np.arange(-count, count + 1) / count
    return np.stack(np.meshgrid(line_px, line_px), axis=-1).reshape(-1, 2)


_HUB_PX, _NEAR_PX = 10.0, 30.0
_SAME_RAD = 2e-3


@dataclass(frozen=True, slots=True, eq=False)
class PointerContext:
    """The view of the user at the time of an event.

    Attributes:
        camera: The user's camera.
        arms: Joints (dof,) of the drawn arms: the goal first, if there is one, then the measured
            arm. Only the first can be moved.
        plane_m: A point (3,) of the plane for clicks on the background; None: the tip's plane.
        other_joints: Positions of joints that are not in the chain to the tip.
        surface: The surface for clicks on the background in the picture of a calibrated camera.
    """

    camera: Camera
    arms: tuple[Vector, ...]
    plane_m: Vector | None = None
    other_joints: Mapping[str, float] = field(default_factory=dict[str, float])
    surface: PictureSurface | None = None


class PickCandidate(NamedTuple):
    """A link or object under the pointer.

    Attributes:
        hit: The hit.
        kind: ``link`` that q moves, ``fixed`` link, or ``object`` of the scene.
        q: Joints (dof,) of the arm to which the link belongs; None for an object.
    """

    hit: Hit
    kind: Literal["link", "fixed", "object"]
    q: Vector | None


class HitTester:
    """Hit test for links, objects and joints at pixels; objects are in the base frame."""

    def __init__(self, chain: Chain, picker: Picker, objects: Picker | None = None) -> None:
        self._chain, self._picker, self._objects = chain, picker, objects
        self._dials = {dial.column: dial for dial in joint_dials(chain, chain.mid_range())}

    def set_objects(self, objects: Picker) -> None:
        """Replace the objects of the scene."""
        self._objects = objects

    def candidates_at(self, at: Vector, context: PointerContext) -> tuple[PickCandidate, ...]:
        """Return everything under the pointer, in the order in which presses select it.

        Moving links come first, links of the goal before links of the measured arm, which is
        painted below; then objects, then fixed links. Within each kind, hits exactly under the
        pointer come before hits next to it, the nearest first.
        """
        camera, drawn = context.camera, list[Vector]()
        moving, objects, fixed = (list[PickCandidate]() for _ in range(3))
        for q in context.arms:
            if any(float(np.abs(q - other).max()) < _SAME_RAD for other in drawn):
                continue  # it coincides with an earlier one
            drawn.append(q)
            poses = link_poses(self._chain, q, context.other_joints)
            hits = self._picker.pick_all_at(camera, poses, at)
            moving += [PickCandidate(hit, "link", q) for hit in hits if self.columns(hit.link)]
            fixed = [PickCandidate(hit, "fixed", q) for hit in hits if not self.columns(hit.link)]
        if self._objects is not None:
            poses = dict.fromkeys(self._objects.names, np.eye(4))
            hits = self._objects.pick_all_at(camera, poses, at)
            objects = [PickCandidate(hit, "object", None) for hit in hits]
        for candidates in (moving, objects, fixed):
            # Hits beside the pointer come last; the order of depth is kept.
            candidates.sort(key=lambda each: each.hit.away_px > 0.0)
        return (*moving, *objects, *fixed)

    def joint_at(
        self, at: Vector, context: PointerContext, found: PickCandidate | None
    ) -> JointDial | None:
        """Find the joint whose hub is under the pointer, or else the joint of the link there."""
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
        """Return the indices in q of the joints that move a link, base to tip."""
        return [step.column for step in self._chain.joints_to(link) if step.scale]

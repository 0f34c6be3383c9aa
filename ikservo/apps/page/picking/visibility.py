"""Visibility of links from a point, and the parts that hide them.

This is the inverse of picking: lines of sight go from the eye to points all over a link, and the
first thing that they hit is visible::

    seen = visible_from(model, arm.where().positions, (0.6, 0.3, 0.4))   # a camera, or a marker
    hidden = [each.link for each in seen if not each.is_visible]
"""

from __future__ import annotations

import math
from collections.abc import Callable, Hashable, Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.apps.page.picking.link_poses import link_poses
from ikservo.apps.page.picking.projection import Camera, Viewport, view_rotation
from ikservo.apps.page.picking.raycast import PickShape, cast_rays, link_shapes, thing_shapes
from ikservo.clock import Clock
from ikservo.errors import UnknownNameError
from ikservo.kinematics import Chain, finite_vector
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.conditioning import (
    Conditioning,
    Singularity,
    conditioning,
    nearest_singularity,
)
from ikservo.model import Model
from ikservo.model.collision_capsules import capsules_of

TABLE = "the table"

_TABLE_M = 3.0
_VISIBLE_FRACTION = 0.01
_LINES = 48  # rays along each side of a link's bounding rectangle in the image
_MIN_RAYS = 16
_MAX_FIELD_RAD = math.tan(math.radians(80.0))
_EYE = Viewport(2.0, 2.0)
_UP, _FORWARD = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])

_SAME_RAD = 5e-3


@dataclass(frozen=True, slots=True)
class LinkVisibility:
    """Visible part of a link, or of an object of the scene.

    Attributes:
        link: The name of the link or object.
        visible_fraction: Visible fraction of its projected area, 0 to 1, accurate to about 0.05.
        hidden_by: Links and things that hide the rest, the largest first.
    """

    link: str
    visible_fraction: float
    hidden_by: tuple[str, ...] = ()

    @property
    def is_visible(self) -> bool:
        """Whether more than one percent of the link is visible."""
        return self.visible_fraction > _VISIBLE_FRACTION


class VisibilityChecker:
    """Computation of the visibility of one arm's links, for any posture and eye.

    Args:
        model: The arm; its boxes and the table occlude what is behind them.
    """

    def __init__(self, model: Model) -> None:
        self._links, self._floor_m = link_shapes(capsules_of(model)), model.floor_m
        self._shapes = self._links | {
            f"{name} (object)" if name in self._links else name: shape
            for name, shape in thing_shapes(model.keep_out).items()
        }
        if model.floor_m is not None:
            corner_m = np.array([_TABLE_M, _TABLE_M, model.floor_m])
            self._shapes[TABLE] = PickShape(np.array([corner_m * (-1.0, -1.0, 1.0), corner_m]))

    def from_point(
        self, poses: Mapping[str, Matrix], eye_m: ArrayLike
    ) -> tuple[LinkVisibility, ...]:
        """Compute the visibility of each link from a point (3,), metres, base frame.

        ``poses`` has T_world_link (4, 4) of each link. A link around the point occludes nothing;
        below the table nothing is visible.
        """
        eye = finite_vector(eye_m, 3, "The point to look from")
        if self._floor_m is not None and eye[2] < self._floor_m:
            return tuple(LinkVisibility(link, 0.0, (TABLE,)) for link in self._links)
        cameras = {
            link: _camera_looking_at(eye, _transform_points(shape.corners_m, poses[link]))
            for link, shape in self._links.items()
        }
        return tuple(self._link_visibility(link, poses, at) for link, at in cameras.items())

    def from_camera(
        self, poses: Mapping[str, Matrix], camera: Camera
    ) -> tuple[LinkVisibility, ...]:
        """Return the visibility of each link from a camera with an unbounded image."""
        return tuple(self._link_visibility(link, poses, camera) for link in self._links)

    def _link_visibility(
        self, link: str, poses: Mapping[str, Matrix], camera: Camera
    ) -> LinkVisibility:
        names, shape = list(self._shapes), self._links[link]
        own = names.index(link)
        corners_px, _ = camera.project(_transform_points(shape.corners_m, poses[link]))
        origins, directions = camera.rays(_pixel_grid(corners_px, camera))
        met = np.isfinite(cast_rays({link: shape}, poses, origins, directions)[:, 0])
        if met.sum() >= _MIN_RAYS:
            origins, directions = origins[met], directions[met]
        else:  # the link is thinner than the grid of rays
            ends_m = shape.capsules[:, :6].reshape(-1, 3)
            ends_px, _ = camera.project(_transform_points(ends_m, poses[link]))
            origins, directions = camera.rays(ends_px)
        all_poses = dict.fromkeys(self._shapes, np.eye(4))
        all_poses |= {name: poses[name] for name in self._links}
        distances = cast_rays(self._shapes, all_poses, origins, directions)
        counts = np.bincount(np.argmin(distances, axis=1), minlength=len(names)) / len(distances)
        hiding = [
            (-float(fraction), i)
            for i, fraction in enumerate(counts)
            if i != own and fraction > 0.0
        ]
        return LinkVisibility(link, float(counts[own]), tuple(names[i] for _, i in sorted(hiding)))


def _camera_looking_at(eye_m: Vector, corners_m: Matrix) -> Camera:
    """Return a camera at a point, pointed at the centre of a box."""
    away = corners_m.mean(axis=0) - eye_m
    length_m = float(np.linalg.norm(away))
    forward = away / length_m if length_m > 1e-6 else _FORWARD
    up = _UP if abs(float(forward[2])) < 0.99 else _FORWARD
    return Camera(_EYE, eye_m, view_rotation(forward, up), 1.0, perspective=True)


def _transform_points(points_m: Matrix, T_world_link: Matrix) -> Matrix:
    return points_m @ T_world_link[:3, :3].T + T_world_link[:3, 3]


def _pixel_grid(corners_px: Matrix, camera: Camera) -> Matrix:
    """Return a grid of pixels (n, 2) around all ``corners_px``, at most 80° off the axis."""
    max_offset = _MAX_FIELD_RAD * camera.scale_px if camera.perspective else math.inf
    centre = camera.viewport.centre_px
    low = np.maximum(corners_px.min(axis=0), centre - max_offset)
    high = np.minimum(corners_px.max(axis=0), centre + max_offset)
    fractions = (np.arange(_LINES) + 0.5) / _LINES
    steps = low + fractions[:, None] * (high - low)
    return np.stack(np.meshgrid(steps[:, 0], steps[:, 1]), axis=-1).reshape(-1, 2)


def visible_from(
    model: Model, joints: Mapping[str, float], eye_m: ArrayLike
) -> tuple[LinkVisibility, ...]:
    """Return which links of an arm are visible from a point, such as the place of a camera.

    Args:
        model: The arm; its keep-out boxes and the table occlude what is behind them.
        joints: Positions by name, rad or m, as ``ArmState.positions``; a missing joint of the
            chain is an error, other missing joints are at zero.
        eye_m: The point (3,), metres, base frame.

    Raises:
        BadValueError: The point is not finite.
        UnknownNameError: A joint of the chain is missing.
    """
    chain = model.chain
    missing = [name for name in chain.names if name not in joints]
    if missing:
        raise UnknownNameError("position", missing[0], joints)
    q = finite_vector([joints[name] for name in chain.names], chain.dof, "The vector of joints")
    return VisibilityChecker(model).from_point(link_poses(chain, q, joints), eye_m)


@dataclass(frozen=True, slots=True, eq=False)
class PostureAnalysis:
    """Analysis of a posture, for one camera.

    Attributes:
        q: The joints (dof,).
        camera: The fingerprint of the camera; see ``Camera.fingerprint``.
        singularity: The nearest singular posture of the tip; None if none was found.
        seen: The visibility of each link.
    """

    q: Vector
    camera: Hashable
    singularity: Singularity | None
    seen: tuple[LinkVisibility, ...]


_CONDITIONING_PERIOD_S = 0.3  # update period for a reader


class PostureAnalyser:
    """Runner of one analysis at a time in the background; callers poll ``get``."""

    def __init__(self, chain: Chain, visibility: VisibilityChecker, clock: Clock) -> None:
        self._chain, self._visibility, self._clock = chain, visibility, clock
        self._conditioned: tuple[float, Conditioning] | None = None
        self._cached: dict[int, PostureAnalysis] = {}
        self._worker = ThreadPoolExecutor(1, thread_name_prefix="ikservo insight")
        self._busy: tuple[int, Future[PostureAnalysis]] | None = None

    def get(
        self,
        client: int,
        q: Vector,
        find_poses: Callable[[], dict[str, Matrix]],
        camera: Camera,
        *,
        idle: bool,
    ) -> PostureAnalysis | None:
        """Return the analysis of a posture (dof,); or return None and, if idle, start it."""
        if self._busy is not None and self._busy[1].done():
            number, future = self._busy
            self._busy = None
            self._cached[number] = future.result()
        cached = self._cached.get(client)
        if (
            cached is not None
            and cached.camera == camera.fingerprint
            and float(np.abs(cached.q - q).max(initial=0.0)) < _SAME_RAD
        ):
            return cached
        if idle and self._busy is None:
            work = self._worker.submit(self._analyse, q.copy(), find_poses(), camera)
            self._busy = client, work
        return None

    def conditioning(self, q: Vector) -> Conditioning:
        """Return the conditioning at joints (dof,), or a result that is less than 0.3 s old."""
        now_s = self._clock.now_s()
        if self._conditioned is None or now_s - self._conditioned[0] >= _CONDITIONING_PERIOD_S:
            self._conditioned = now_s, conditioning(self._chain, q)
        return self._conditioned[1]

    def close(self) -> None:
        """Cancel the running analysis."""
        self._worker.shutdown(wait=False, cancel_futures=True)

    def _analyse(self, q: Vector, poses: dict[str, Matrix], camera: Camera) -> PostureAnalysis:
        seen = self._visibility.from_camera(poses, camera)
        return PostureAnalysis(q, camera.fingerprint, nearest_singularity(self._chain, q), seen)

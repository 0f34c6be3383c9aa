"""Cameras: world to screen and back, exact inverses, and viewing rays.

Pixels are CSS pixels from the top left corner, y downwards; only ``Viewport`` uses device pixels.
World coordinates are the arm's base frame in metres. A depth is a distance [m] from the eye along
the optical axis, never along a slanted ray::

    px, depth_m = camera.project(points_m)        # (…, 3) -> (…, 2), (…)
    points_m = camera.unproject(px, depth_m)      # (…, 2), (…) -> (…, 3)
    ray = camera.ray(px)                          # Ray: origin_m, direction
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.errors import BadValueError
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.rays import Ray

NEAR_PLANE_M = 1e-3
"""Minimum depth of a perspective camera; nearer points are drawn as if at this depth."""

_MAX_PX, _MAX_PIXEL_RATIO = 16384.0, 16.0


@dataclass(frozen=True, slots=True)
class Viewport:
    """The page's drawing area.

    Attributes:
        width_px: CSS pixels.
        height_px: CSS pixels.
        pixel_ratio: Device pixels per CSS pixel.

    Raises:
        BadValueError: A number is not finite, not above zero, or too large.
    """

    width_px: float
    height_px: float
    pixel_ratio: float = 1.0

    def __post_init__(self) -> None:
        _check_bounded("The viewport's width", self.width_px, _MAX_PX)
        _check_bounded("The viewport's height", self.height_px, _MAX_PX)
        _check_bounded("The device pixel ratio", self.pixel_ratio, _MAX_PIXEL_RATIO)

    @property
    def centre_px(self) -> Vector:
        """The centre (2,) in CSS pixels."""
        return np.array([0.5 * self.width_px, 0.5 * self.height_px])


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """A perspective or orthographic camera: position, orientation and scale.

    Attributes:
        viewport: The drawing area.
        eye_m: Position of the eye (3,), metres.
        R_world_view: Columns (3, 3): right and up on the screen, and towards the user.
        scale_px: Pixels per metre of an orthographic camera; for a perspective one the focal
            length in pixels (pixels per metre at a depth of one metre).
        perspective: Whether it is a perspective camera.
    """

    viewport: Viewport
    eye_m: Vector
    R_world_view: Matrix
    scale_px: float
    perspective: bool = False

    @property
    def fingerprint(self) -> tuple[object, ...]:
        """A key that is equal for cameras with the same projection."""
        return (self.viewport, self.eye_m.tobytes(), self.R_world_view.tobytes(), self.scale_px,
                self.perspective)  # fmt: skip

    @property
    def right(self) -> Vector:
        """Direction (3,) to the right on the screen."""
        return self.R_world_view[:, 0]

    @property
    def up(self) -> Vector:
        """Direction (3,) upwards on the screen."""
        return self.R_world_view[:, 1]

    @property
    def forward(self) -> Vector:
        """The direction (3,) of the optical axis."""
        return -self.R_world_view[:, 2]

    def depth_of(self, points_m: ArrayLike) -> Vector:
        """Compute the depths (…) of points (…, 3)."""
        depth: Vector = (np.asarray(points_m, dtype=np.float64) - self.eye_m) @ self.forward
        return depth

    def pixels_per_metre(self, depth_m: ArrayLike) -> Vector:
        """Return pixels per metre across the line of sight (…), at depths (…)."""
        depth = np.asarray(depth_m, dtype=np.float64)
        if not self.perspective:
            return np.full(depth.shape, self.scale_px)
        return self.scale_px / np.maximum(depth, NEAR_PLANE_M)

    def pixels_at(self, across_px: Matrix) -> Matrix:
        """Compute the pixels (…, 2) at offsets (…, 2) from the optical axis, without distortion."""
        px: Matrix = self.viewport.centre_px + across_px
        return px

    def across_px(self, px: Matrix) -> Matrix:
        """Compute the offsets (…, 2) of pixels; inverse of ``pixels_at``."""
        offsets_px: Matrix = px - self.viewport.centre_px
        return offsets_px

    def project(self, points_m: ArrayLike) -> tuple[Matrix, Vector]:
        """Compute the pixels (…, 2) of points (…, 3), and their depths (…)."""
        in_view = (np.asarray(points_m, dtype=np.float64) - self.eye_m) @ self.R_world_view
        depth_m = -in_view[..., 2]
        across = in_view[..., :2] * _DOWNWARDS * self.pixels_per_metre(depth_m)[..., None]
        return self.pixels_at(across), depth_m

    def unproject(self, px: ArrayLike, depth_m: ArrayLike) -> Matrix:
        """Compute the points (…, 3) at pixels (…, 2) and depths (…); inverse of ``project``."""
        offset_px = self.across_px(np.asarray(px, dtype=np.float64))
        depth = np.asarray(depth_m, dtype=np.float64)
        across = offset_px * _DOWNWARDS / self.pixels_per_metre(depth)[..., None]
        in_view = np.concatenate([across, -depth[..., None]], axis=-1)
        points: Matrix = in_view @ self.R_world_view.T + self.eye_m
        return points

    def ray(self, px: ArrayLike) -> Ray:
        """Return the line of sight through a pixel (2,)."""
        origins, directions = self.rays(np.asarray(px, dtype=np.float64)[None])
        return Ray(origins[0], directions[0])

    def rays(self, px: ArrayLike) -> tuple[Matrix, Matrix]:
        """Compute origins and unit directions (n, 3) of the lines of sight through (n, 2)."""
        pixels = np.asarray(px, dtype=np.float64)
        if not self.perspective:
            origins = self.unproject(pixels, np.zeros(len(pixels)))
            return origins, np.broadcast_to(self.forward, origins.shape)
        offsets_m = self.unproject(pixels, np.ones(len(pixels))) - self.eye_m
        directions: Matrix = (
            offsets_m / np.sqrt(np.einsum("ni,ni->n", offsets_m, offsets_m))[:, None]
        )
        return np.broadcast_to(self.eye_m, directions.shape), directions

    def shift(self, move_px: ArrayLike, depth_m: float) -> Vector:
        """Compute the vector (3,) parallel to the screen for a motion by pixels (2,) at a depth."""
        across = np.asarray(move_px, dtype=np.float64) * _DOWNWARDS
        shift: Vector = self.R_world_view[:, :2] @ (across / self.pixels_per_metre(depth_m))
        return shift


def view_rotation(forward: ArrayLike, up: ArrayLike) -> Matrix:
    """Return R_world_view (3, 3) with the optical axis along ``forward``, ``up`` (3,) upwards."""
    back = -np.asarray(forward, dtype=np.float64)
    back = back / math.sqrt(float(back @ back))
    right = np.cross(np.asarray(up, dtype=np.float64), back)
    right = right / math.sqrt(float(right @ right))
    return np.column_stack([right, np.cross(back, right), back])


_DOWNWARDS = np.array([1.0, -1.0])


def _check_bounded(what: str, value: float, max_value: float) -> None:
    if not 0.0 < value <= max_value:  # also rejects NaN
        raise BadValueError(what, value, f"a number above 0 and at most {max_value:g}")

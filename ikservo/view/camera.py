"""Cameras: world to screen and back, exact inverses, and viewing rays.

Pixels are CSS pixels from the top left corner, y downwards; only ``Viewport`` knows of device
pixels. World coordinates are the arm's base frame in metres. A depth is a distance [m] from the
eye along the direction in which it looks, never along a slanted ray::

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

__all__ = ["NEAR_PLANE_M", "Camera", "Ray", "Viewport", "view_rotation"]


_PARALLEL_RAY = 1e-9


@dataclass(frozen=True, slots=True, eq=False)
class Ray:
    """A half line from the eye into the world.

    Attributes:
        origin_m: Where it starts (3,), metres.
        direction: Where it goes, a unit vector (3,).
    """

    origin_m: Vector
    direction: Vector

    def at(self, way_m: float) -> Vector:
        """Return the point (3,) that far along."""
        return self.origin_m + way_m * self.direction

    def intersect_plane(self, point_m: Vector, normal: Vector) -> Vector | None:
        """Return where it meets a plane (3,); None where it runs along it or away from it."""
        slope = float(self.direction @ normal)
        if abs(slope) < _PARALLEL_RAY:
            return None
        way_m = float((point_m - self.origin_m) @ normal) / slope
        return None if way_m < 0.0 else self.at(way_m)


NEAR_PLANE_M = 1e-3
"""What is nearer to the eye of a perspective camera is drawn as if it were this far away."""

_MAX_PX, _MAX_PIXEL_RATIO = 16384.0, 16.0


@dataclass(frozen=True, slots=True)
class Viewport:
    """The page's drawing area.

    Attributes:
        width_px: CSS pixels.
        height_px: CSS pixels.
        pixel_ratio: Device pixels for each CSS pixel.

    Raises:
        BadValueError: A number is not finite, not above zero or absurdly large.
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
        """Return the middle (2,) in CSS pixels."""
        return np.array([0.5 * self.width_px, 0.5 * self.height_px])


@dataclass(frozen=True, slots=True, eq=False)
class Camera:
    """An eye, the directions of the screen, and how large a metre appears.

    Attributes:
        viewport: What it draws on.
        eye_m: Where the eye is (3,), metres.
        R_world_view: Columns: the screen's right, its up, and back towards the person (3, 3).
        scale_px: Pixels for each metre of an orthographic camera; of a perspective one, pixels
            for each metre one metre away.
        perspective: Whether far things are small.
    """

    viewport: Viewport
    eye_m: Vector
    R_world_view: Matrix
    scale_px: float
    perspective: bool = False

    @property
    def fingerprint(self) -> tuple[object, ...]:
        """Return what differs where something is seen elsewhere."""
        return (self.viewport, self.eye_m.tobytes(), self.R_world_view.tobytes(), self.scale_px,
                self.perspective)  # fmt: skip

    @property
    def right(self) -> Vector:
        """Return the direction (3,) that is to the right on the screen."""
        return self.R_world_view[:, 0]

    @property
    def up(self) -> Vector:
        """Return the direction (3,) that is up on the screen."""
        return self.R_world_view[:, 1]

    @property
    def forward(self) -> Vector:
        """Return the direction (3,) in which the eye looks."""
        return -self.R_world_view[:, 2]

    def depth_of(self, points_m: ArrayLike) -> Vector:
        """Return the depths (…) of points (…, 3)."""
        depth: Vector = (np.asarray(points_m, dtype=np.float64) - self.eye_m) @ self.forward
        return depth

    def pixels_per_metre(self, depth_m: ArrayLike) -> Vector:
        """Return how large a metre across the line of sight appears (…), at depths (…)."""
        depth = np.asarray(depth_m, dtype=np.float64)
        if not self.perspective:
            return np.full(depth.shape, self.scale_px)
        return self.scale_px / np.maximum(depth, NEAR_PLANE_M)

    def project(self, points_m: ArrayLike) -> tuple[Matrix, Vector]:
        """Return the pixels (…, 2) of points (…, 3), and their depths (…)."""
        seen = (np.asarray(points_m, dtype=np.float64) - self.eye_m) @ self.R_world_view
        depth_m = -seen[..., 2]
        across = seen[..., :2] * _DOWNWARDS * self.pixels_per_metre(depth_m)[..., None]
        return self.viewport.centre_px + across, depth_m

    def unproject(self, px: ArrayLike, depth_m: ArrayLike) -> Matrix:
        """Return the points (…, 3) that are at pixels (…, 2) in depths (…) (lecture L14)."""
        away = np.asarray(px, dtype=np.float64) - self.viewport.centre_px
        depth = np.asarray(depth_m, dtype=np.float64)
        across = away * _DOWNWARDS / self.pixels_per_metre(depth)[..., None]
        seen = np.concatenate([across, -depth[..., None]], axis=-1)
        points: Matrix = seen @ self.R_world_view.T + self.eye_m
        return points

    def ray(self, px: ArrayLike) -> Ray:
        """Return the line of sight through a pixel (2,) (lecture L15)."""
        origins, directions = self.rays(np.asarray(px, dtype=np.float64)[None])
        return Ray(origins[0], directions[0])

    def rays(self, px: ArrayLike) -> tuple[Matrix, Matrix]:
        """Return origins and unit directions (n, 3) of the lines of sight through (n, 2)."""
        pixels = np.asarray(px, dtype=np.float64)
        if not self.perspective:
            origins = self.unproject(pixels, np.zeros(len(pixels)))
            return origins, np.broadcast_to(self.forward, origins.shape)
        away = self.unproject(pixels, np.ones(len(pixels))) - self.eye_m
        directions: Matrix = away / np.sqrt(np.einsum("ni,ni->n", away, away))[:, None]
        return np.broadcast_to(self.eye_m, directions.shape), directions

    def shift(self, move_px: ArrayLike, depth_m: float) -> Vector:
        """Return the vector (3,) parallel to the screen that pixels (2,) mean (lecture L19)."""
        across = np.asarray(move_px, dtype=np.float64) * _DOWNWARDS
        shift: Vector = self.R_world_view[:, :2] @ (across / self.pixels_per_metre(depth_m))
        return shift


def view_rotation(forward: ArrayLike, up: ArrayLike) -> Matrix:
    """Return R_world_view (3, 3) of an eye that looks along a direction, ``up`` (3,) upwards."""
    back = -np.asarray(forward, dtype=np.float64)
    back = back / math.sqrt(float(back @ back))
    right = np.cross(np.asarray(up, dtype=np.float64), back)
    right = right / math.sqrt(float(right @ right))
    return np.column_stack([right, np.cross(back, right), back])


_DOWNWARDS = np.array([1.0, -1.0])


def _check_bounded(what: str, value: float, largest: float) -> None:
    if not 0.0 < value <= largest:  # also refuses what is not a number
        raise BadValueError(what, value, f"above 0, at most {largest:g}")

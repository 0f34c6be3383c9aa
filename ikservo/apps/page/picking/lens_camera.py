"""The page's camera for the picture of a real camera, with the distortion of its lens."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ikservo.apps.cameras.arm_camera import first_seen
from ikservo.apps.cameras.camera_model import CameraModel
from ikservo.apps.page.picking.projection import Camera, Viewport
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model.arm_model import Obstacle

_AXES = np.array([1.0, -1.0, -1.0])  # in OpenCV, y is down and z ahead


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class LensCamera(Camera):
    """A calibrated camera whose whole picture is in the middle of the drawing.

    Attributes:
        model: The camera.
        zoom: CSS pixels per pixel of the picture.
        left_top_px: The top left corner of the picture (2,), CSS pixels.
    """

    model: CameraModel
    zoom: float
    left_top_px: Vector

    def pixels_at(self, across_px: Matrix) -> Matrix:
        """Compute the pixels (…, 2) for undistorted offsets (…, 2), applying the distortion."""
        px = self.model.pixels(across_px / self.scale_px)
        return (px + 0.5) * self.zoom + self.left_top_px

    def across_px(self, px: Matrix) -> Matrix:
        """Compute the offsets (…, 2) of pixels; inverse of ``pixels_at``."""
        return self.scale_px * self.model.flat((px - self.left_top_px) / self.zoom - 0.5)

    def picture_px(self, px: Vector) -> tuple[float, float]:
        """Return the pixel (u, v) of the camera's own picture at a pixel (2,) of the drawing."""
        u, v = ((px - self.left_top_px) / self.zoom - 0.5).tolist()
        return u, v

    def fields(self) -> dict[str, object]:
        """Return lens and place of the picture for the page."""
        lens = self.model.lens
        focal = self.zoom * np.diag(lens.matrix)[:2]
        centre = (lens.matrix[:2, 2] + 0.5) * self.zoom + self.left_top_px
        return {
            "focal": focal.tolist(),
            "centre": centre.tolist(),
            "distortion": lens.distortion.tolist(),
            "widest": self.model.widest,
        }


def make_lens_camera(model: CameraModel, viewport: Viewport) -> LensCamera:
    """Make a camera whose picture fills the drawing."""
    size, drawing = np.array(model.lens.size), np.array([viewport.width_px, viewport.height_px])
    zoom = float((drawing / size).min())
    return LensCamera(
        viewport,
        model.T_base_camera[:3, 3],
        model.T_base_camera[:3, :3] * _AXES,
        zoom * float(model.lens.matrix[0, 0]),
        perspective=True,
        model=model,
        zoom=zoom,
        left_top_px=0.5 * (drawing - zoom * size),
    )


@dataclass(frozen=True, slots=True, eq=False)
class PictureSurface:
    """The surface on which clicks in a camera's picture are targets.

    Attributes:
        things: The things of the scene.
        z_m: The height of the level plane, base frame.
    """

    things: tuple[Obstacle, ...]
    z_m: float

    def point_at(self, camera: Camera, px: Vector) -> Vector:
        """Return the point (3,) that a pixel (2,) sees.

        Raises:
            InputError: The pixel is outside the picture, or shows neither plane nor thing.
        """
        if isinstance(camera, LensCamera):
            ray = camera.model.ray(*camera.picture_px(px))
        else:
            ray = camera.ray(px)
        return first_seen(ray, self.things, self.z_m).point_m

"""A calibrated camera, which converts points in the arm's base frame to pixels and back to rays.

A pixel (u, v) is counted as in OpenCV: u to the right, v down, (0, 0) at the centre of the first
pixel.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from ikservo.apps.cameras.board_detection import Intrinsics
from ikservo.errors import BadValueError
from ikservo.kinematics.arrays import FrozenArrays, Matrix, Vector
from ikservo.kinematics.rays import Ray

_WIDEST = 3.0  # tangent of the largest angle to the axis for which a lens is trusted
_NEAR_FOLD = 0.95  # fraction of the radius at which the lens polynomial stops increasing
# points nearer to the camera than this, or behind it, are projected from this depth
_MIN_DEPTH_M = 1e-3
_HALVINGS = 30  # halvings of the interval that contains the radius before distortion
_STEPS = 20  # largest number of Newton steps
_ENOUGH = 1e-12  # remaining error of a direction, as a tangent
_SMALL = 1e-6  # step for the derivatives of a direction, and smallest squared radius
_PARALLEL = 1e-12  # smallest radius used as a divisor
_MAX_OFF_PX = 0.1  # allowed reprojection error of a direction that was found


@dataclass(frozen=True, eq=False)
class CameraModel(FrozenArrays):
    """A camera that is fixed in front of an arm.

    Attributes:
        lens: The projection of the lens.
        T_base_camera: The pose (4, 4): x to the right in the picture, y down, z ahead.
    """

    lens: Intrinsics
    T_base_camera: Matrix

    def project(self, points_m: ArrayLike) -> tuple[Matrix, Vector]:
        """Compute pixels (…, 2) and depths [m] (…) of points (…, 3) in the base frame.

        A point that is not in front of the camera has no pixel; it gets the pixel of a point 1 mm
        ahead.
        """
        T = self.T_base_camera
        ahead = (np.asarray(points_m, dtype=np.float64) - T[:3, 3]) @ T[:3, :3]
        depth_m = ahead[..., 2]
        flat = ahead[..., :2] / np.maximum(depth_m, _MIN_DEPTH_M)[..., None]
        return self.pixels(flat), depth_m

    def ray(self, u: float, v: float) -> Ray:
        """Return the ray through a pixel, in the base frame.

        Raises:
            BadValueError: The pixel is not in the picture, or its direction is unknown, because the
                stored lens model is nearly not invertible there.
        """
        width, height = self.lens.size
        if not (-0.5 <= u <= width - 0.5 and -0.5 <= v <= height - 0.5):  # also rejects NaN
            raise BadValueError(
                "The pixel", f"{u:g}, {v:g}", f"a pixel of the {width} x {height} picture"
            )
        flat = self.flat(np.array([u, v]))
        off_px = float(np.abs(self.pixels(flat) - (u, v)).max())
        if not off_px < _MAX_OFF_PX:
            raise BadValueError("The pixel", f"{u:g}, {v:g}", "a pixel nearer to the centre")
        ahead = np.append(flat, 1.0)
        direction = self.T_base_camera[:3, :3] @ ahead
        return Ray(self.T_base_camera[:3, 3], direction / np.linalg.norm(direction))

    def pixels(self, flat: Matrix) -> Matrix:
        """Compute pixels (…, 2) from directions given as x/z and y/z (…, 2)."""
        return self._bent(flat) * self._focal_px + self._centre_px

    def flat(self, px: Matrix) -> Matrix:
        """Compute directions, as x/z and y/z (…, 2), from pixels; the inverse of ``pixels``."""
        wanted = (px - self._centre_px) / self._focal_px
        found = self._radially_straight(wanted)
        for _ in range(_STEPS):  # Newton's method
            off = self._bent(found) - wanted
            if float(np.abs(off).max(initial=0.0)) < _ENOUGH:
                break
            (a, c), (b, d) = (
                np.moveaxis((self._bent(found + step) - wanted - off) / _SMALL, -1, 0)
                for step in _SMALL * np.eye(2)
            )
            determinant = a * d - b * c
            x, y = off[..., 0], off[..., 1]
            found -= np.stack([d * x - b * y, a * y - c * x], axis=-1) / determinant[..., None]
        return found

    def _radially_straight(self, bent: Matrix) -> Matrix:
        """Return directions (…, 2) from which only the radial distortion is removed, by bisection.

        Newton's method does not always converge where the lens model is nearly not invertible.
        """
        k1, k2, _, _, k3 = self.lens.distortion.tolist()
        wanted: Vector = np.asarray(np.linalg.norm(bent, axis=-1))
        ends = 1.0 + self.widest**2 * (k1 + self.widest**2 * (k2 + self.widest**2 * k3))
        low: Vector = np.zeros_like(wanted)
        high: Vector = np.maximum(wanted / ends, self.widest)
        for _ in range(_HALVINGS):
            middle = 0.5 * (low + high)
            r2 = np.minimum(middle, self.widest) ** 2
            is_beyond = middle * (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))) > wanted
            low += np.where(is_beyond, 0.0, middle - low)
            high -= np.where(is_beyond, high - middle, 0.0)
        return bent * (0.5 * (low + high) / np.maximum(wanted, _PARALLEL))[..., None]

    @cached_property
    def widest(self) -> float:
        """Tangent of the maximum angle to the axis at which the lens polynomial is used.

        The polynomial may stop increasing at some radius; beyond it the projection is linear.
        """
        k1, k2, _, _, k3 = self.lens.distortion.tolist()
        turns = np.roots([7.0 * k3, 5.0 * k2, 3.0 * k1, 1.0])
        squares = [float(each.real) for each in turns if abs(each.imag) < _SMALL < each.real]
        return min([_WIDEST, *(_NEAR_FOLD * math.sqrt(each) for each in squares)])

    def _bent(self, flat: Matrix) -> Matrix:
        """Apply the distortion of the lens, at a focal length of 1, to directions (…, 2)."""
        k1, k2, p1, p2, k3 = self.lens.distortion.tolist()
        beyond = np.maximum(np.linalg.norm(flat, axis=-1) / self.widest, 1.0)
        x, y = np.moveaxis(flat / beyond[..., None], -1, 0)
        r2 = x * x + y * y
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        bent = [
            x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x),
            y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y,
        ]
        return beyond[..., None] * np.stack(bent, axis=-1)

    @cached_property
    def _focal_px(self) -> Vector:
        return np.diag(self.lens.matrix)[:2].copy()

    @cached_property
    def _centre_px(self) -> Vector:
        return self.lens.matrix[:2, 2].copy()

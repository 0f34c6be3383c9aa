"""Coloured blocks on the table, from a picture of a calibrated camera; nothing is learnt."""

from __future__ import annotations

import math
from typing import Any, cast

import numpy as np

from ikservo.apps.cameras.camera_model import CameraModel
from ikservo.apps.cameras.pictures import Picture
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model.scene_file import KeepOutShape, make_shape

_MOST = 8
_HUES = {"red": 0, "orange": 14, "yellow": 28, "green": 60, "cyan": 90, "blue": 115, "purple": 145}
_ALL_HUES = 180  # OpenCV counts hues in steps of 2 degrees
_LEAST_SATURATION, _LEAST_VALUE = 90, 40
_LEAST_PX = 12.0  # width of a block in the picture
_LARGEST_M = 0.15
_YAWS_RAD = np.radians([0.0, 22.5, 45.0, 67.5])
_DIRECTIONS = np.array(
    [(math.cos(a), math.sin(a)) for a in np.arange(0.0, math.tau, math.tau / 32)]
)
_CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
_PRIOR_PX = 2.0  # a block is a cube, if the picture does not tell
_WORST_PX, _WORST_SHARE = 1.5, 0.03  # error of an outline: pixels, and a share of the block


def find_blocks(model: CameraModel, picture: Picture, table_m: float) -> list[KeepOutShape]:
    """Find at most eight coloured blocks, the largest in the picture first.

    Args:
        model: The camera that took the picture.
        picture: A picture (h, w, 3), blue first.
        table_m: The height of the table, on which they stand.

    Returns:
        Boxes in the base frame, each named after its colour.
    """
    if picture.ndim == 2:
        return []
    import cv2 as opencv  # noqa: PLC0415  # of the extra `camera`

    cv2 = cast("Any", opencv)  # its stubs are incomplete

    hue, saturation, value = cv2.split(cv2.cvtColor(picture, cv2.COLOR_BGR2HSV))
    hues = np.array(list(_HUES.values()))
    apart = np.abs((hue[..., None] - hues + _ALL_HUES / 2) % _ALL_HUES - _ALL_HUES / 2)
    nearest = apart.argmin(axis=2)
    is_coloured = (saturation > _LEAST_SATURATION) & (value > _LEAST_VALUE)
    found: list[tuple[float, KeepOutShape]] = []
    for i, colour in enumerate(_HUES):
        mask = cv2.medianBlur(((nearest == i) & is_coloured).astype(np.uint8), 5)
        for outline in cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]:
            block = _fit_block(model, outline[:, 0].astype(float), table_m, f"the {colour} block")
            if block is not None:
                found.append((cv2.contourArea(outline), block))
    found.sort(key=lambda each: -each[0])
    return [block for _, block in found[:_MOST]]


def _fit_block(
    model: CameraModel, outline_px: Matrix, table_m: float, name: str
) -> KeepOutShape | None:
    """Fit an upright box on the table to an outline (n, 2); None if it has another shape."""
    from scipy.optimize import least_squares  # noqa: PLC0415  # takes longer than a command

    if np.ptp(outline_px, axis=0).min() < _LEAST_PX or (outline_px.min() < 1.0):
        return None
    reach_px = (outline_px @ _DIRECTIONS.T).max(axis=0) + 0.5  # to the edge of the last pixels
    middle = model.ray(*outline_px.mean(axis=0).tolist())
    distance_m = middle.distance_to_level_m(table_m)
    if not math.isfinite(distance_m):
        return None
    x, y, _ = middle.at(distance_m)
    px_per_m = float(model.lens.matrix[0, 0]) / distance_m
    side = math.log(float(np.ptp(outline_px, axis=0).mean()) / px_per_m / 1.5)

    def corners(p: Vector) -> Matrix:
        size = np.exp(p[3:])
        c, s = math.cos(p[2]), math.sin(p[2])
        R = np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])
        return (_CORNERS * size) @ R.T + (p[0], p[1], table_m)

    def errors(p: Vector) -> Vector:
        px, _ = model.project(corners(p))
        unlike = _PRIOR_PX * np.array([p[3] - p[4], p[5] - (p[3] + p[4]) / 2.0])
        return np.append((px @ _DIRECTIONS.T).max(axis=0) - reach_px, unlike)

    fits: list[Any] = [least_squares(errors, (x, y, yaw, side, side, side)) for yaw in _YAWS_RAD]
    best = min(fits, key=lambda fit: float(fit.cost))
    rms_px = float(np.sqrt(np.mean(best.fun[: len(_DIRECTIONS)] ** 2)))
    size_m = np.exp(best.x[3:])
    if rms_px > _WORST_PX + _WORST_SHARE * np.ptp(outline_px) / 2.0 or size_m.max() > _LARGEST_M:
        return None
    at_m = (best.x[0], best.x[1], table_m + size_m[2] / 2.0)
    turned = (0.0, 0.0, math.degrees(best.x[2]))
    return make_shape("box", name, {"center_m": at_m, "size_m": size_m, "rpy_deg": turned})

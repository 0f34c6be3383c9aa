"""Find coloured blocks on the table in a picture of a calibrated camera; no trained model."""

from __future__ import annotations

import math
from time import perf_counter
from typing import Any, cast

import numpy as np

from ikservo.apps.cameras.board_detection import Picture
from ikservo.apps.cameras.camera_model import CameraModel
from ikservo.errors import BadValueError, InputError
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import rotation_rpy
from ikservo.model.scene_file import KeepOutShape, make_shape

_MAX_BLOCKS = 8
_MAX_OUTLINES = 30  # the largest outlines, to which blocks are fitted
_HUES = {"red": 0, "orange": 14, "yellow": 28, "green": 60, "cyan": 90, "blue": 115, "purple": 145}
_ALL_HUES = 180  # OpenCV counts hues in steps of 2 degrees
_MIN_SATURATION = 90  # of 255; less is grey
_MIN_VALUE = 40  # of 255; less is black
_MIN_WIDTH_PX = 12.0  # smallest width of a block in the picture
_MAX_SIDE_M = 0.15  # the longest side of a block
_MAX_EVALUATIONS = 100  # largest number of evaluations in a fit
_SEARCH_S = 5.0  # time after which no other outline is fitted
_YAWS_RAD = np.radians([0.0, 22.5, 45.0, 67.5])  # initial values of the fits
_ANGLES_RAD = np.arange(0.0, math.tau, math.tau / 32)
_DIRECTIONS = np.array([np.cos(_ANGLES_RAD), np.sin(_ANGLES_RAD)])
_CORNERS = np.array([(x, y, z) for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (0.0, 1.0)])
_PRIOR_PX = 0.7  # weight of the prior that a block is a cube, pixels per ratio of its sides
_MAX_ERROR_PX = 1.5  # largest error of a fitted outline
_MAX_ERROR_SHARE = 0.015  # added to that error, as a fraction of the block's size


def find_blocks(model: CameraModel, picture: Picture, table_m: float) -> list[KeepOutShape]:
    """Find at most eight coloured blocks on a table, the largest in the picture first.

    Returns:
        Upright boxes in the base frame, each named after its colour; none in a grey picture.
    """
    import cv2 as opencv  # noqa: PLC0415  # from the extra `camera`

    if picture.ndim == 2:
        return []
    cv2, found = cast("Any", opencv), list[tuple[float, KeepOutShape]]()  # its stubs are incomplete
    hue, saturation, value = cv2.split(cv2.cvtColor(picture, cv2.COLOR_BGR2HSV))
    apart = np.arange(_ALL_HUES)[:, None] - np.array(list(_HUES.values())) + _ALL_HUES / 2
    nearest = np.abs(apart % _ALL_HUES - _ALL_HUES / 2).argmin(axis=1).astype(np.uint8)[hue]
    nearest[(saturation <= _MIN_SATURATION) | (value <= _MIN_VALUE)] = len(_HUES)
    outlines = list[tuple[float, str, Any]]()
    for i, colour in enumerate(_HUES):
        mask = cv2.medianBlur((nearest == i).astype(np.uint8), 5)
        for outline in cv2.findContours(mask, cv2.RETR_EXTERNAL, cv2.CHAIN_APPROX_NONE)[0]:
            outlines.append((cv2.contourArea(outline), colour, outline[:, 0].astype(float)))
    until_s = perf_counter() + _SEARCH_S
    for area, colour, outline in sorted(outlines, key=lambda each: -each[0])[:_MAX_OUTLINES]:
        in_time = perf_counter() < until_s
        block = _fit_block(model, outline, table_m, f"the {colour} block") if in_time else None
        if block is not None:
            found.append((area, block))
    return [block for _, block in sorted(found, key=lambda each: -each[0])[:_MAX_BLOCKS]]


def find_block_at(
    model: CameraModel, picture: Picture, table_m: float, u: float, v: float
) -> KeepOutShape:
    """Return the block that a pixel (u, v) shows; see ``find_blocks``.

    Raises:
        InputError: The pixel shows no block.
    """
    ray, blocks = model.ray(u, v), find_blocks(model, picture, table_m)
    nearest = min(blocks, key=lambda each: ray.distance_to_thing_m(each.row), default=None)
    if nearest is None or not math.isfinite(ray.distance_to_thing_m(nearest.row)):
        raise InputError("The pixel shows no coloured block.", "Choose the middle of a block.")
    return nearest


def _fit_block(
    model: CameraModel, outline_px: Matrix, table_m: float, name: str
) -> KeepOutShape | None:
    """Fit an upright box on the table to an outline (n, 2); None if it has a different shape."""
    from scipy.optimize import least_squares  # noqa: PLC0415  # slow to import

    try:
        middle = model.ray(*outline_px.mean(axis=0).tolist())
    except BadValueError:  # the lens is not known there
        return None
    distance_m, extent_px = middle.distance_to_level_m(table_m), np.ptp(outline_px, axis=0)
    if extent_px.min() < _MIN_WIDTH_PX or not math.isfinite(distance_m):
        return None
    reach_px = (outline_px @ _DIRECTIONS).max(axis=0) + 0.5  # the outer edge of the last pixels
    side_m = float(extent_px.mean()) * distance_m / float(model.lens.matrix[0, 0]) / 1.5

    def errors(p: Vector) -> Vector:
        corners_m = (_CORNERS * np.exp(p[3:])) @ rotation_rpy(0.0, 0.0, float(p[2])).T
        px, _ = model.project(corners_m + np.append(p[:2], table_m))
        unlike = _PRIOR_PX * np.array([p[3] - p[4], p[5] - (p[3] + p[4]) / 2.0])
        return np.append((px @ _DIRECTIONS).max(axis=0) - reach_px, unlike)

    x, y, _ = middle.at(distance_m).tolist()
    first = [(x, y, yaw_rad, *np.log([side_m] * 3)) for yaw_rad in _YAWS_RAD]
    fits = [cast("Any", least_squares(errors, each, max_nfev=_MAX_EVALUATIONS)) for each in first]
    best = min(fits, key=lambda fit: float(fit.cost))
    p: Vector = best.x
    off_px, size_m = math.sqrt(2.0 * best.cost / len(best.fun)), np.exp(p[3:])
    max_error_px = _MAX_ERROR_PX + _MAX_ERROR_SHARE * float(extent_px.max())
    if off_px > max_error_px or size_m.max() > _MAX_SIDE_M:
        return None
    at = {"center_m": (p[0], p[1], table_m + size_m[2] / 2.0), "size_m": size_m}
    return make_shape("box", name, {**at, "rpy_deg": (0.0, 0.0, math.degrees(p[2]))})

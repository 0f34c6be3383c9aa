"""What stands around the arm: the table, a grid to measure by, boxes to keep out of."""

from __future__ import annotations

import itertools
import math

import numpy as np

from ikservo.kinematics.se3 import Matrix
from ikservo.model.model import KeepOut
from ikservo.view.camera.camera import Camera
from ikservo.view.camera.stage import Stage
from ikservo.view.scene.items import Item, polygon, polyline, polylines, text

__all__ = ["draw_box", "draw_floor", "draw_scale"]

_GRID_M, _LINES = 0.1, 10
_LEVEL, _FROM_ABOVE = 0.02, 0.98
_SCALES_M = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
_MARGIN_PX, _WIDEST = 16.0, 0.3
_CORNERS = np.array(list(itertools.product((0.0, 1.0), repeat=3)))


def draw_floor(stage: Stage, camera: Camera, floor_m: float) -> list[Item]:
    """Return the table: an edge from the side, a grid from everywhere else."""
    slope = abs(float(camera.forward[2]))
    if not camera.perspective and slope < _LEVEL:
        return [_edge(stage, camera, floor_m)]
    half = _GRID_M * _LINES
    centre = np.round(stage.pivot_m / _GRID_M) * _GRID_M
    centre[2] = floor_m
    corners = centre + half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    table = [] if slope > _FROM_ABOVE and not camera.perspective else [_sheet(camera, corners)]
    return [*table, *_grid(camera, centre, half)]


def draw_box(camera: Camera, box: KeepOut, style: str = "keep_out") -> Item:
    """Return a keep-out box as its six faces filled together."""
    low, high = np.array(box.low_m), np.array(box.high_m)
    px, _ = camera.project(low + _CORNERS * (high - low))
    return polygon(style, [_turning_left(px[list(face)]) for face in _FACES], name=box.name)


def draw_scale(camera: Camera) -> list[Item]:
    """Return a bar of a round length at the lower left; a perspective picture has no scale."""
    if camera.perspective:
        return []
    widest_px = _WIDEST * camera.viewport.width_px
    fitting = (m for m in _SCALES_M if m * camera.scale_px <= widest_px)
    length_m = next(fitting, _SCALES_M[-1])
    y = camera.viewport.height_px - _MARGIN_PX
    ends = [[_MARGIN_PX, y], [_MARGIN_PX + length_m * camera.scale_px, y]]
    words = f"{length_m * 100:g} cm" if length_m >= 0.01 else f"{length_m * 1000:g} mm"
    return [polyline("scale", ends), text("scale", [_MARGIN_PX, y - 6.0], words)]


def _edge(stage: Stage, camera: Camera, floor_m: float) -> Item:
    """Return the table seen from its edge, as wide as the picture, down to its lower end."""
    level = stage.pivot_m * (1.0, 1.0, 0.0) + np.array([0.0, 0.0, floor_m])
    y = float(camera.project(level)[0][1])
    width, bottom = camera.viewport.width_px, max(camera.viewport.height_px, y)
    return polygon("floor", [[[0.0, y], [width, y], [width, bottom], [0.0, bottom]]])


def _sheet(camera: Camera, corners_m: Matrix) -> Item:
    return polygon("floor", [camera.project(_before(camera, corners_m))[0]])


def _grid(camera: Camera, centre_m: Matrix, half_m: float) -> list[Item]:
    """Return lines every 10 cm."""
    beside = np.linspace(-half_m, half_m, 2 * _LINES + 1)
    ends = np.zeros((2, len(beside), 2, 3))
    for along in (0, 1):
        ends[along, :, :, along] = (-half_m, half_m)
        ends[along, :, :, 1 - along] = beside[:, None]
    lines = (centre_m + ends).reshape(-1, 2, 3)
    if not camera.perspective or float(camera.depth_of(lines).min()) >= _NEAREST_M:
        return polylines("grid", camera.project(lines)[0])
    return [polyline("grid", camera.project(_before(camera, line))[0]) for line in lines]


def _before(camera: Camera, points_m: Matrix) -> Matrix:
    """Return a line or sheet (n, 3) with what is behind a perspective eye cut off."""
    if not camera.perspective:
        return points_m
    depth = camera.depth_of(points_m)
    if float(depth.min()) >= _NEAREST_M:
        return points_m
    kept: list[Matrix] = []
    for a, b, da, db in zip(
        points_m, np.roll(points_m, -1, axis=0), depth, np.roll(depth, -1), strict=True
    ):
        if da >= _NEAREST_M:
            kept.append(a)
        if (da >= _NEAREST_M) != (db >= _NEAREST_M):
            kept.append(a + (b - a) * ((_NEAREST_M - da) / (db - da)))
    return np.array(kept).reshape(-1, 3)


def _turning_left(ring_px: Matrix) -> Matrix:
    """Return a ring so directed that faces filled together never cut holes into each other."""
    x, y = ring_px.T
    area = float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    return ring_px if not math.isfinite(area) or area >= 0.0 else ring_px[::-1]


_NEAREST_M = 0.02
_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))

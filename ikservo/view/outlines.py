"""Outlines of the links on the screen, the floor, grid and keep-out boxes."""

from __future__ import annotations

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.capsules import Capsule
from ikservo.model.model import KeepOutBox
from ikservo.view.camera import Camera
from ikservo.view.draw_items import DrawItem, polygon, polyline, polylines, text
from ikservo.view.viewpoints import ArmExtent

__all__ = ["Silhouette", "SilhouetteRenderer", "draw_box", "draw_floor", "draw_scale"]


_SPHERE_CORNERS = 20
_ANGLES = np.arange(_SPHERE_CORNERS) * (math.tau / _SPHERE_CORNERS)
_ROUND = np.column_stack([np.cos(_ANGLES), np.sin(_ANGLES)])
_INSIDE_FRACTION = 0.9  # an eye inside a sphere is treated as just outside of it


@dataclass(frozen=True, slots=True, eq=False)
class Silhouette:
    """The silhouette of one link.

    Attributes:
        depth_m: Depth of its centre.
        rings: An outline for each of its capsules (capsules, k, 2), CSS pixels.
    """

    link: str
    depth_m: float
    rings: Matrix


class SilhouetteRenderer:
    """The capsules of an arm as arrays for drawing.

    Args:
        capsules: Any number for each link, in link coordinates.
    """

    def __init__(self, capsules: Sequence[Capsule]) -> None:
        ordered = sorted(capsules, key=lambda capsule: capsule.link)
        owners = [capsule.link for capsule in ordered]
        self.links = tuple(dict.fromkeys(owners))
        self._first = [owners.index(link) for link in self.links]
        self._counts = counts = np.diff([*self._first, len(owners)])
        self._spans = [slice(a, a + n) for a, n in zip(self._first, counts.tolist(), strict=True)]
        self._owner = np.array([self.links.index(link) for link in owners], dtype=np.intp)
        ends = [(capsule.start_m, capsule.end_m) for capsule in ordered]
        self._ends = np.array(ends, dtype=np.float64).reshape(-1, 2, 3)
        self._radii_m = np.array([capsule.radius_m for capsule in ordered])

    def outlines_from(self, camera: Camera, poses: Mapping[str, Matrix]) -> list[Silhouette]:
        """Return the silhouettes at ``poses`` T_world_link (4, 4), the farthest first."""
        if not self.links:
            return []
        ends = self._world_ends(poses)
        rings = _convex_outlines(*_sphere_outlines(camera, ends, self._radii_m[:, None]))
        sums = np.add.reduceat(camera.depth_of(ends).mean(axis=1), self._first)
        depths: list[float] = (sums / self._counts).tolist()
        found = [
            Silhouette(link, depth, rings[span])
            for link, depth, span in zip(self.links, depths, self._spans, strict=True)
        ]
        return sorted(found, key=lambda outline: -outline.depth_m)

    def _world_ends(self, poses: Mapping[str, Matrix]) -> Matrix:
        """Return both ends (capsules, 2, 3) in world coordinates."""
        T = np.array([poses[link] for link in self.links])[self._owner]
        placed: Matrix = self._ends @ T[:, :3, :3].transpose(0, 2, 1) + T[:, None, :3, 3]
        return placed


def _sphere_outlines(camera: Camera, centres_m: Matrix, radii_m: Matrix) -> tuple[Matrix, Matrix]:
    """Return the outlines (n, k, 2) of the spheres at the first and second ends (n, 2, 3).

    From an eye at distance d the outline of a sphere of radius r is its circle of tangency:
    nearer by r²/d, and smaller by sqrt(1 - (r/d)²).
    """
    radii = np.broadcast_to(radii_m, centres_m.shape[:-1])[..., None]
    right, up = camera.right, camera.up
    if camera.perspective:
        away = centres_m - camera.eye_m
        d = np.sqrt(np.einsum("...i,...i->...", away, away))[..., None]
        radii = np.minimum(radii, _INSIDE_FRACTION * d)
        centres_m = centres_m - away * (radii / d) ** 2
        radii = radii * np.sqrt(1.0 - (radii / d) ** 2)
        right = _unit_vectors(np.cross(away, camera.up))
        up = _unit_vectors(np.cross(right, away))
    across = _ROUND[:, :1] * right[..., None, :] + _ROUND[:, 1:] * up[..., None, :]
    px, _ = camera.project(centres_m[..., None, :] + radii[..., None] * across)
    return px[:, 0], px[:, 1]


def _convex_outlines(first: Matrix, second: Matrix) -> Matrix:
    """Return the convex outline (n, k, 2) of two circles: the farther point in each direction."""
    directions = _ROUND * (1.0, -1.0)
    second_is_farther = np.einsum("nki,ki->nk", second - first, directions) > 0.0
    return np.where(second_is_farther[..., None], second, first)


def _unit_vectors(v: Vector) -> Vector:
    length: Vector = np.sqrt(np.einsum("...i,...i->...", v, v))[..., None]
    return v / np.maximum(length, 1e-12)


_GRID_M, _LINES = 0.1, 10
_LEVEL, _FROM_ABOVE = 0.02, 0.98
_SCALES_M = (1.0, 0.5, 0.2, 0.1, 0.05, 0.02, 0.01, 0.005, 0.002, 0.001)
_MARGIN_PX, _MAX_WIDTH = 16.0, 0.3
_BOX_CORNERS = np.array(list(itertools.product((0.0, 1.0), repeat=3)))


def draw_floor(extent: ArmExtent, camera: Camera, floor_m: float) -> list[DrawItem]:
    """Return the table: its edge in a level view, else a grid."""
    slope = abs(float(camera.forward[2]))
    if not camera.perspective and slope < _LEVEL:
        return [_draw_table_edge(extent, camera, floor_m)]
    half = _GRID_M * _LINES
    centre = np.round(extent.pivot_m / _GRID_M) * _GRID_M
    centre[2] = floor_m
    corners = centre + half * np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    table = [] if slope > _FROM_ABOVE and not camera.perspective else [_draw_sheet(camera, corners)]
    return [*table, *_draw_grid(camera, centre, half)]


def draw_box(camera: Camera, box: KeepOutBox, style: str = "keep_out") -> DrawItem:
    """Return a keep-out box as its six faces filled together."""
    low, high = np.array(box.low_m), np.array(box.high_m)
    px, _ = camera.project(low + _BOX_CORNERS * (high - low))
    return polygon(
        style, [_orient_counterclockwise(px[list(face)]) for face in _FACES], name=box.name
    )


def draw_scale(camera: Camera) -> list[DrawItem]:
    """Return a scale bar of a round length at the lower left; none in a perspective view."""
    if camera.perspective:
        return []
    max_width_px = _MAX_WIDTH * camera.viewport.width_px
    fitting = (m for m in _SCALES_M if m * camera.scale_px <= max_width_px)
    length_m = next(fitting, _SCALES_M[-1])
    y = camera.viewport.height_px - _MARGIN_PX
    ends = [[_MARGIN_PX, y], [_MARGIN_PX + length_m * camera.scale_px, y]]
    label = f"{length_m * 100:g} cm" if length_m >= 0.01 else f"{length_m * 1000:g} mm"
    return [polyline("scale", ends), text("scale", [_MARGIN_PX, y - 6.0], label)]


def _draw_table_edge(extent: ArmExtent, camera: Camera, floor_m: float) -> DrawItem:
    """Return the table seen edge-on, as wide as the viewport, down to its lower end."""
    level = extent.pivot_m * (1.0, 1.0, 0.0) + np.array([0.0, 0.0, floor_m])
    y = float(camera.project(level)[0][1])
    width, bottom = camera.viewport.width_px, max(camera.viewport.height_px, y)
    return polygon("floor", [[[0.0, y], [width, y], [width, bottom], [0.0, bottom]]])


def _draw_sheet(camera: Camera, corners_m: Matrix) -> DrawItem:
    return polygon("floor", [camera.project(_clip_to_front(camera, corners_m))[0]])


def _draw_grid(camera: Camera, centre_m: Matrix, half_m: float) -> list[DrawItem]:
    """Return lines every 10 cm."""
    offsets = np.linspace(-half_m, half_m, 2 * _LINES + 1)
    ends = np.zeros((2, len(offsets), 2, 3))
    for along in (0, 1):
        ends[along, :, :, along] = (-half_m, half_m)
        ends[along, :, :, 1 - along] = offsets[:, None]
    lines = (centre_m + ends).reshape(-1, 2, 3)
    if not camera.perspective or float(camera.depth_of(lines).min()) >= _MIN_DEPTH_M:
        return polylines("grid", camera.project(lines)[0])
    return [polyline("grid", camera.project(_clip_to_front(camera, line))[0]) for line in lines]


def _clip_to_front(camera: Camera, points_m: Matrix) -> Matrix:
    """Return a line or polygon (n, 3), clipped at the near plane of a perspective camera."""
    if not camera.perspective:
        return points_m
    depth = camera.depth_of(points_m)
    if float(depth.min()) >= _MIN_DEPTH_M:
        return points_m
    clipped: list[Matrix] = []
    for a, b, da, db in zip(
        points_m, np.roll(points_m, -1, axis=0), depth, np.roll(depth, -1), strict=True
    ):
        if da >= _MIN_DEPTH_M:
            clipped.append(a)
        if (da >= _MIN_DEPTH_M) != (db >= _MIN_DEPTH_M):
            clipped.append(a + (b - a) * ((_MIN_DEPTH_M - da) / (db - da)))
    return np.array(clipped).reshape(-1, 3)


def _orient_counterclockwise(ring_px: Matrix) -> Matrix:
    """Return a ring with positive orientation, so that faces filled together have no holes."""
    x, y = ring_px.T
    area = float(x @ np.roll(y, -1) - y @ np.roll(x, -1))
    return ring_px if not math.isfinite(area) or area >= 0.0 else ring_px[::-1]


_MIN_DEPTH_M = 0.02
_FACES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))

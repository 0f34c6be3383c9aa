"""The ways a person looks at an arm: from the side, above, in front, or walking round it.

A ``View`` is what the person has chosen; with the ``Stage`` of the arm it gives the camera::

    stage = stage_of(model)
    view = View(views_of(stage)[0])               # "side", or "plane" for a flat arm
    camera = camera_of(stage, view, Viewport(800, 600, 2.0), stage.yaw_rad(q))

While a drag lasts keep the camera that it began with, else the arm's own plane turns under the
pointer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.view.camera.camera import Camera, Viewport, looking_along
from ikservo.view.camera.stage import Stage

__all__ = ["View", "ViewName", "camera_of", "views_of"]

ViewName = Literal["side", "top", "front", "orbit", "plane"]

_MARGIN = 1.15
_LEAST_ZOOM, _MOST_ZOOM = 0.2, 20.0
_FARTHEST_PAN_M = 10.0
_STEEPEST_RAD = math.radians(88)
_AWAY_M = 10.0
_HALF_FIELD_RAD = math.radians(17)
_, _Y, _Z = np.eye(3)


@dataclass(frozen=True, slots=True)
class View:
    """Where a person looks from.

    Attributes:
        name: Which way; ``plane`` is along the axes of a flat arm.
        zoom: 1 shows all of the stage.
        pan_m: How far right of and above the stage's middle the picture's middle is.
        yaw_rad: Of ``orbit``: how far round, 0 looks at the arm from where it points at home.
        pitch_rad: Of ``orbit``: from how far above.
    """

    name: ViewName
    zoom: float = 1.0
    pan_m: tuple[float, float] = (0.0, 0.0)
    yaw_rad: float = math.radians(-60)
    pitch_rad: float = math.radians(25)

    def zoomed(self, factor: float) -> View:
        """Return the view nearer (a factor above 1) or further away."""
        return replace(self, zoom=_within(self.zoom * factor, _LEAST_ZOOM, _MOST_ZOOM))

    def panned(self, move_px: tuple[float, float], camera: Camera, depth_m: float) -> View:
        """Return the view in which what is at that depth has moved by pixels on the screen."""
        metre_px = float(camera.pixels_per_metre(depth_m))
        right_m = self.pan_m[0] - move_px[0] / metre_px
        up_m = self.pan_m[1] + move_px[1] / metre_px
        far = _FARTHEST_PAN_M
        return replace(self, pan_m=(_within(right_m, -far, far), _within(up_m, -far, far)))

    def turned(self, yaw_rad: float, pitch_rad: float) -> View:
        """Return the orbit further round and further up, never over the top."""
        return replace(
            self,
            yaw_rad=math.remainder(self.yaw_rad + yaw_rad, math.tau),
            pitch_rad=_within(self.pitch_rad + pitch_rad, -_STEEPEST_RAD, _STEEPEST_RAD),
        )


def views_of(stage: Stage) -> tuple[ViewName, ...]:
    """Return the views that show something of the arm, the one to begin with first."""
    return ("side", "top", "front", "orbit") if stage.across is None else ("plane",)


def camera_of(stage: Stage, view: View, viewport: Viewport, yaw_rad: float) -> Camera:
    """Return the camera of a view.

    Args:
        stage: What there is to see.
        view: The person's choice.
        viewport: What it is drawn on.
        yaw_rad: Where the arm's own plane looks, see ``Stage.yaw_rad``; for ``side`` only.
    """
    if view.name == "orbit":
        return _orbit(stage, view, viewport)
    R, middle, size = _framed(stage, view, yaw_rad)
    fit_px = min(viewport.width_px / size[0], viewport.height_px / size[1]) / _MARGIN
    eye = middle + R @ np.array([*view.pan_m, _AWAY_M])
    return Camera(viewport, eye, R, fit_px * view.zoom)


def _framed(stage: Stage, view: View, yaw_rad: float) -> tuple[Matrix, Vector, Vector]:
    """Return R_world_view of a flat view, the middle (3,) and the size (2,) of what it shows."""
    if view.name == "side":
        T = stage.plane(yaw_rad)
        low, high = stage.own_m
        return T[:3, :3], T[:3, :3] @ (0.5 * (low + high)) + T[:3, 3], _size(high - low)
    if view.name == "front":
        R = looking_along(-stage.plane(stage.home_yaw_rad)[:3, 0], _Z)
    elif view.name == "plane" and stage.across is not None:
        R = looking_along(-stage.across, _Y if abs(stage.across[2]) > 0.5 else _Z)
    else:
        R = looking_along(-_Z, _Y)
    return R, stage.box_m.mean(axis=0), _size(np.abs(R.T) @ (stage.box_m[1] - stage.box_m[0]))


def _orbit(stage: Stage, view: View, viewport: Viewport) -> Camera:
    """Return a perspective camera that goes round the middle of the stage."""
    azimuth = stage.home_yaw_rad + view.yaw_rad
    level = math.cos(view.pitch_rad)
    away = np.array(
        [level * math.cos(azimuth), level * math.sin(azimuth), math.sin(view.pitch_rad)]
    )
    R = looking_along(-away, _Z)
    radius_m = 0.35 * float(np.linalg.norm(stage.own_m[1] - stage.own_m[0]))
    distance_m = radius_m / math.sin(_HALF_FIELD_RAD) / view.zoom
    eye = stage.box_m.mean(axis=0) + R @ np.array([*view.pan_m, distance_m])
    focal_px = 0.5 * min(viewport.width_px, viewport.height_px) / math.tan(_HALF_FIELD_RAD)
    return Camera(viewport, eye, R, focal_px, perspective=True)


def _size(extent_m: Vector) -> Vector:
    """Return width and height to show, of an arm that may be as flat as a sheet."""
    return np.maximum(extent_m[:2], 0.1 * float(extent_m.max()))


def _within(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)

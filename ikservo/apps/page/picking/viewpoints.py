"""Viewpoints: side, top, front, orbit, fitted to the extent of an arm.

A ``Viewpoint`` is the choice of the user; with the ``ArmExtent`` of the arm it gives the
camera::

    extent = arm_extent(model)
    view = Viewpoint(available_views(extent)[0])    # "side", or "plane" for a flat arm
    camera = make_camera(extent, view, Viewport(800, 600, 2.0), extent.yaw_rad(q))

During a drag, keep the camera of its start; otherwise the arm's own plane rotates under the
pointer.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from ikservo.apps.page.picking.projection import Camera, Viewport, view_rotation
from ikservo.ik.workspace import quasi_random_joints
from ikservo.ik.workspace_grid import side_plane
from ikservo.kinematics import JointType
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import make_pose
from ikservo.model import Model

_SAMPLES = 2000
_VERTICAL_COSINE, _PARALLEL = 0.99, 1e-3
_BELOW_TABLE_M = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class ArmExtent:
    """The space in which an arm moves.

    Attributes:
        across: The common joint axis (3,) of a flat arm; None for other arms.
        box_m: Corners (2, 3) of the volume its links can reach above the table, base frame.
        own_m: The same corners in coordinates of the arm's own plane: outwards, up, across.
        pivot_m: The point (3,) of the first axis at the height of the base.
        home: Joints (dof,) of the usual working posture.
        home_yaw_rad: Yaw of the arm's own plane about z at ``home``.
        turns: Rotation of that plane with the first joint: 1, -1, or 0 if it does not rotate.
    """

    across: Vector | None
    box_m: Matrix
    own_m: Matrix
    pivot_m: Vector
    home: Vector
    home_yaw_rad: float
    turns: int

    def yaw_rad(self, q: Vector) -> float:
        """Compute the yaw of the arm's own vertical plane about z at joints (dof,)."""
        return self.home_yaw_rad + self.turns * float(q[0] - self.home[0])

    def plane(self, yaw_rad: float) -> Matrix:
        """Return the vertical plane (4, 4) through the first axis: u outwards, v up, w across."""
        return make_pose(self.pivot_m, _vertical_axes(yaw_rad))


def arm_extent(model: Model) -> ArmExtent:
    """Sample the space that an arm can occupy."""
    chain, home = model.chain, home_joints(model)
    T_world_side = side_plane(chain, home)
    u = T_world_side[:3, 0]
    T, J = chain.forward_and_jacobian(home)
    # The point of the first axis that is nearest to the tip; J = axis x (tip - pivot), axis. For a
    # prismatic joint, it is the tip itself.
    first_pivot = T[:3, 3] + np.cross(J[3:, 0], J[:3, 0])
    pivot = T_world_side[:3, 3] + u * float(first_pivot @ u)
    yaw_rad, axis_z = math.atan2(float(u[1]), float(u[0])), float(J[5, 0])
    is_upright = chain.kinds[0] is JointType.REVOLUTE and abs(axis_z) >= _VERTICAL_COSINE
    turns = round(axis_z) if is_upright else 0
    axes = J[3:].T
    is_flat = all(kind is JointType.REVOLUTE for kind in chain.kinds) and (
        float(np.abs(np.cross(axes, axes[0])).max(initial=0.0)) < _PARALLEL
    )
    q = quasi_random_joints(chain, _SAMPLES)
    links = np.stack([T[:, :3, 3] for T in chain.link_poses(q).values()], axis=1)
    if model.floor_m is not None:
        links[..., 2] = np.maximum(links[..., 2], model.floor_m - _BELOW_TABLE_M)
    yaws_rad = yaw_rad + turns * (q[:, 0] - home[0])
    return ArmExtent(
        across=axes[0] if is_flat else None,
        box_m=_bounding_box(links),
        own_m=_bounding_box((links - pivot) @ _vertical_axes(yaws_rad)),
        pivot_m=pivot,
        home=home,
        home_yaw_rad=yaw_rad,
        turns=turns,
    )


def home_joints(model: Model) -> Vector:
    """Return the joints (dof,) of the pose "home", or the middle of every range."""
    return model.chain_pose("home") if "home" in model.poses else model.chain.mid_range()


def _vertical_axes(yaw_rad: ArrayLike) -> Matrix:
    """Compute the axes (…, 3, 3) of vertical planes at yaws (…): outwards, up, across."""
    c, s, zero = np.cos(yaw_rad), np.sin(yaw_rad), np.zeros_like(yaw_rad)
    rows = [[c, zero, s], [s, zero, -c], [zero, zero + 1.0, zero]]
    axes = np.array(rows)
    return axes if axes.ndim == 2 else np.moveaxis(axes, (0, 1), (-2, -1))


def _bounding_box(points_m: Matrix) -> Matrix:
    points = points_m.reshape(-1, 3)
    return np.array([points.min(axis=0), points.max(axis=0)])


ViewName = Literal["side", "top", "front", "orbit", "plane", "camera"]

_MARGIN = 1.15
_MIN_ZOOM, _MAX_ZOOM = 0.2, 20.0
_MAX_PAN_M = 10.0
_MAX_PITCH_RAD = math.radians(88)
_EYE_DISTANCE_M = 10.0
_HALF_FIELD_RAD = math.radians(17)
_, _Y, _Z = np.eye(3)


@dataclass(frozen=True, slots=True)
class Viewpoint:
    """The viewpoint that a user has chosen.

    Attributes:
        name: The direction; ``plane`` looks along the axes of a flat arm, ``camera`` is the picture
            of a calibrated camera.
        zoom: Zoom factor; 1 shows the whole extent.
        pan_m: Offset of the image centre, right of and above the extent's centre.
        yaw_rad: Azimuth of ``orbit``; 0 is in front of the arm at home.
        pitch_rad: Elevation of ``orbit``.
    """

    name: ViewName
    zoom: float = 1.0
    pan_m: tuple[float, float] = (0.0, 0.0)
    yaw_rad: float = math.radians(-60)
    pitch_rad: float = math.radians(25)

    def zoom_by(self, factor: float) -> Viewpoint:
        """Return the view zoomed in (a factor above 1) or out."""
        return replace(self, zoom=_clamp_value(self.zoom * factor, _MIN_ZOOM, _MAX_ZOOM))

    def pan_by(self, move_px: tuple[float, float], camera: Camera, depth_m: float) -> Viewpoint:
        """Return the view in which points at a depth are moved by pixels on the screen."""
        metre_px = float(camera.pixels_per_metre(depth_m))
        right_m = self.pan_m[0] - move_px[0] / metre_px
        up_m = self.pan_m[1] + move_px[1] / metre_px
        limit = _MAX_PAN_M
        return replace(
            self, pan_m=(_clamp_value(right_m, -limit, limit), _clamp_value(up_m, -limit, limit))
        )

    def orbit_by(self, yaw_rad: float, pitch_rad: float) -> Viewpoint:
        """Return the orbit view rotated by yaw and pitch; it never passes over the top."""
        return replace(
            self,
            yaw_rad=math.remainder(self.yaw_rad + yaw_rad, math.tau),
            pitch_rad=_clamp_value(self.pitch_rad + pitch_rad, -_MAX_PITCH_RAD, _MAX_PITCH_RAD),
        )


def available_views(extent: ArmExtent) -> tuple[ViewName, ...]:
    """Return the useful views of an arm, the default first."""
    return ("side", "top", "front", "orbit") if extent.across is None else ("plane",)


def make_camera(extent: ArmExtent, view: Viewpoint, viewport: Viewport, yaw_rad: float) -> Camera:
    """Make the camera of a view; only ``side`` needs the yaw, see ``ArmExtent.yaw_rad``."""
    if view.name == "orbit":
        return _orbit_camera(extent, view, viewport)
    R, centre, size = _frame_view(extent, view, yaw_rad)
    fit_px = min(viewport.width_px / size[0], viewport.height_px / size[1]) / _MARGIN
    eye = centre + R @ np.array([*view.pan_m, _EYE_DISTANCE_M])
    return Camera(viewport, eye, R, fit_px * view.zoom)


def _frame_view(
    extent: ArmExtent, view: Viewpoint, yaw_rad: float
) -> tuple[Matrix, Vector, Vector]:
    """Return R_world_view of an orthographic view, and its centre (3,) and size (2,)."""
    if view.name == "side":
        T = extent.plane(yaw_rad)
        low, high = extent.own_m
        return T[:3, :3], T[:3, :3] @ (0.5 * (low + high)) + T[:3, 3], _view_size(high - low)
    if view.name == "front":
        R = view_rotation(-extent.plane(extent.home_yaw_rad)[:3, 0], _Z)
    elif view.name == "plane" and extent.across is not None:
        R = view_rotation(-extent.across, _Y if abs(extent.across[2]) > 0.5 else _Z)
    else:
        R = view_rotation(-_Z, _Y)
    return (
        R,
        extent.box_m.mean(axis=0),
        _view_size(np.abs(R.T) @ (extent.box_m[1] - extent.box_m[0])),
    )


def _orbit_camera(extent: ArmExtent, view: Viewpoint, viewport: Viewport) -> Camera:
    """Return a perspective camera on an orbit around the centre of the extent."""
    azimuth = extent.home_yaw_rad + view.yaw_rad
    level = math.cos(view.pitch_rad)
    direction = np.array(
        [level * math.cos(azimuth), level * math.sin(azimuth), math.sin(view.pitch_rad)]
    )
    R = view_rotation(-direction, _Z)
    radius_m = 0.35 * float(np.linalg.norm(extent.own_m[1] - extent.own_m[0]))
    distance_m = radius_m / math.sin(_HALF_FIELD_RAD) / view.zoom
    eye = extent.box_m.mean(axis=0) + R @ np.array([*view.pan_m, distance_m])
    focal_px = 0.5 * min(viewport.width_px, viewport.height_px) / math.tan(_HALF_FIELD_RAD)
    return Camera(viewport, eye, R, focal_px, perspective=True)


def _view_size(extent_m: Vector) -> Vector:
    """Return width and height to show, with a minimum for flat arms."""
    return np.maximum(extent_m[:2], 0.1 * float(extent_m.max()))


def _clamp_value(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)

"""Viewpoints: side, top, front, orbit, fitted to the extent of an arm.

A ``Viewpoint`` is what the user has chosen; with the ``ArmExtent`` of the arm it gives the
camera::

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
from numpy.typing import ArrayLike

from ikservo.ik.workspace import quasi_random_joints
from ikservo.ik.workspace_grid import side_plane
from ikservo.kinematics import Chain, JointType
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.kinematics.se3 import make_pose
from ikservo.model import Model
from ikservo.view.camera import Camera, Viewport, view_rotation

__all__ = [
    "ArmExtent",
    "ViewName",
    "Viewpoint",
    "arm_extent",
    "available_views",
    "home_joints",
    "make_camera",
]


_SAMPLES = 2000
_VERTICAL_COSINE, _PARALLEL = 0.99, 1e-3
_BELOW_TABLE_M = 0.02


@dataclass(frozen=True, slots=True, eq=False)
class ArmExtent:
    """The room that an arm moves in.

    Attributes:
        across: The axis (3,) that all joints of a flat arm turn about; None for other arms.
        box_m: Corners (2, 3) of where its links can be above the table, base frame.
        own_m: The same in the arm's own plane, as if that never turned: outwards, up, across.
        pivot_m: The point (3,) of the first axis that is level with the base.
        home: Joints (dof,) in which the arm usually works.
        home_yaw_rad: Where its own plane looks about z there.
        turns: How that plane turns with the first joint: 1, -1, or 0 where it does not.
    """

    across: Vector | None
    box_m: Matrix
    own_m: Matrix
    pivot_m: Vector
    home: Vector
    home_yaw_rad: float
    turns: int

    def yaw_rad(self, q: Vector) -> float:
        """Return where the arm's own vertical plane looks about z at joints (dof,)."""
        return self.home_yaw_rad + self.turns * float(q[0] - self.home[0])

    def plane(self, yaw_rad: float) -> Matrix:
        """Return the vertical plane (4, 4) through the first axis: u outwards, v up, w across."""
        return make_pose(self.pivot_m, _vertical_axes(yaw_rad))


def arm_extent(model: Model) -> ArmExtent:
    """Look at where an arm can be."""
    chain, home = model.chain, home_joints(model)
    T_world_side = side_plane(chain, home)
    u = T_world_side[:3, 0]
    pivot = T_world_side[:3, 3] + u * float(_first_pivot(chain, home) @ u)
    yaw_rad, turns = math.atan2(float(u[1]), float(u[0])), _plane_rotation_sign(chain, home)
    q = quasi_random_joints(chain, _SAMPLES)
    links = np.stack([T[:, :3, 3] for T in chain.link_poses(q).values()], axis=1)
    if model.floor_m is not None:
        links[..., 2] = np.maximum(links[..., 2], model.floor_m - _BELOW_TABLE_M)
    yaws_rad = yaw_rad + turns * (q[:, 0] - home[0])
    return ArmExtent(
        across=_common_axis(chain, home),
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
    """Return the axes (…, 3, 3) of planes that look where yaws (…) say: outwards, up, across."""
    c, s, zero = np.cos(yaw_rad), np.sin(yaw_rad), np.zeros_like(yaw_rad)
    rows = [[c, zero, s], [s, zero, -c], [zero, zero + 1.0, zero]]
    return np.moveaxis(np.array(rows), (0, 1), (-2, -1))


def _first_pivot(chain: Chain, home: Vector) -> Vector:
    """Return the point (3,) of the first axis that is nearest to the tip."""
    T, J = chain.forward_and_jacobian(home)
    tip: Vector = T[:3, 3]
    return tip + np.cross(J[3:, 0], J[:3, 0])  # J = axis x (tip - pivot); 0 for a slide


def _plane_rotation_sign(chain: Chain, home: Vector) -> int:
    """Return how the arm's own plane turns with the first joint; only about an upright axis."""
    upwards = float(chain.jacobian(home)[5, 0])
    if chain.kinds[0] is not JointType.REVOLUTE or abs(upwards) < _VERTICAL_COSINE:
        return 0
    return round(upwards)


def _common_axis(chain: Chain, home: Vector) -> Vector | None:
    """Return the axis (3,) that all joints turn about, if there is one."""
    axes = chain.jacobian(home)[3:].T
    apart = float(np.abs(np.cross(axes, axes[0])).max(initial=0.0))
    turning = all(kind is JointType.REVOLUTE for kind in chain.kinds)
    return axes[0] if turning and apart < _PARALLEL else None


def _bounding_box(points_m: Matrix) -> Matrix:
    points = points_m.reshape(-1, 3)
    return np.array([points.min(axis=0), points.max(axis=0)])


ViewName = Literal["side", "top", "front", "orbit", "plane"]

_MARGIN = 1.15
_MIN_ZOOM, _MAX_ZOOM = 0.2, 20.0
_MAX_PAN_M = 10.0
_MAX_PITCH_RAD = math.radians(88)
_EYE_DISTANCE_M = 10.0
_HALF_FIELD_RAD = math.radians(17)
_, _Y, _Z = np.eye(3)


@dataclass(frozen=True, slots=True)
class Viewpoint:
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

    def zoom_by(self, factor: float) -> Viewpoint:
        """Return the view nearer (a factor above 1) or further away."""
        return replace(self, zoom=_clamp_value(self.zoom * factor, _MIN_ZOOM, _MAX_ZOOM))

    def pan_by(self, move_px: tuple[float, float], camera: Camera, depth_m: float) -> Viewpoint:
        """Return the view in which what is at that depth has moved by pixels on the screen."""
        metre_px = float(camera.pixels_per_metre(depth_m))
        right_m = self.pan_m[0] - move_px[0] / metre_px
        up_m = self.pan_m[1] + move_px[1] / metre_px
        far = _MAX_PAN_M
        return replace(
            self, pan_m=(_clamp_value(right_m, -far, far), _clamp_value(up_m, -far, far))
        )

    def orbit_by(self, yaw_rad: float, pitch_rad: float) -> Viewpoint:
        """Return the orbit further round and further up, never over the top."""
        return replace(
            self,
            yaw_rad=math.remainder(self.yaw_rad + yaw_rad, math.tau),
            pitch_rad=_clamp_value(self.pitch_rad + pitch_rad, -_MAX_PITCH_RAD, _MAX_PITCH_RAD),
        )


def available_views(stage: ArmExtent) -> tuple[ViewName, ...]:
    """Return the views that show something of the arm, the one to begin with first."""
    return ("side", "top", "front", "orbit") if stage.across is None else ("plane",)


def make_camera(stage: ArmExtent, view: Viewpoint, viewport: Viewport, yaw_rad: float) -> Camera:
    """Return the camera of a view.

    Args:
        stage: What there is to see.
        view: The person's choice.
        viewport: What it is drawn on.
        yaw_rad: Where the arm's own plane looks, see ``Stage.yaw_rad``; for ``side`` only.
    """
    if view.name == "orbit":
        return _orbit_camera(stage, view, viewport)
    R, middle, size = _frame_view(stage, view, yaw_rad)
    fit_px = min(viewport.width_px / size[0], viewport.height_px / size[1]) / _MARGIN
    eye = middle + R @ np.array([*view.pan_m, _EYE_DISTANCE_M])
    return Camera(viewport, eye, R, fit_px * view.zoom)


def _frame_view(stage: ArmExtent, view: Viewpoint, yaw_rad: float) -> tuple[Matrix, Vector, Vector]:
    """Return R_world_view of a flat view, the middle (3,) and the size (2,) of what it shows."""
    if view.name == "side":
        T = stage.plane(yaw_rad)
        low, high = stage.own_m
        return T[:3, :3], T[:3, :3] @ (0.5 * (low + high)) + T[:3, 3], _view_size(high - low)
    if view.name == "front":
        R = view_rotation(-stage.plane(stage.home_yaw_rad)[:3, 0], _Z)
    elif view.name == "plane" and stage.across is not None:
        R = view_rotation(-stage.across, _Y if abs(stage.across[2]) > 0.5 else _Z)
    else:
        R = view_rotation(-_Z, _Y)
    return R, stage.box_m.mean(axis=0), _view_size(np.abs(R.T) @ (stage.box_m[1] - stage.box_m[0]))


def _orbit_camera(stage: ArmExtent, view: Viewpoint, viewport: Viewport) -> Camera:
    """Return a perspective camera that goes round the middle of the stage."""
    azimuth = stage.home_yaw_rad + view.yaw_rad
    level = math.cos(view.pitch_rad)
    away = np.array(
        [level * math.cos(azimuth), level * math.sin(azimuth), math.sin(view.pitch_rad)]
    )
    R = view_rotation(-away, _Z)
    radius_m = 0.35 * float(np.linalg.norm(stage.own_m[1] - stage.own_m[0]))
    distance_m = radius_m / math.sin(_HALF_FIELD_RAD) / view.zoom
    eye = stage.box_m.mean(axis=0) + R @ np.array([*view.pan_m, distance_m])
    focal_px = 0.5 * min(viewport.width_px, viewport.height_px) / math.tan(_HALF_FIELD_RAD)
    return Camera(viewport, eye, R, focal_px, perspective=True)


def _view_size(extent_m: Vector) -> Vector:
    """Return width and height to show, of an arm that may be as flat as a sheet."""
    return np.maximum(extent_m[:2], 0.1 * float(extent_m.max()))


def _clamp_value(value: float, low: float, high: float) -> float:
    return min(max(value, low), high)

"""Joint ranges as arcs with a needle, or tracks for prismatic joints.

A frame is drawn sixty times a second, so the points of all arcs are transformed and projected
together: one joint or ten cost nearly the same.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ikservo.kinematics import Chain, ChainJoint, JointType
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.model.model import at_limit, near_limit
from ikservo.view.camera import Camera
from ikservo.view.draw_items import DrawItem, to_pixels

__all__ = ["JointArcs", "JointDial", "joint_dials", "limit_proximity"]


LimitProximity = Literal["limit", "amber", "red"]

_MIN_ARM_M = 0.005


@dataclass(frozen=True, slots=True, eq=False)
class JointDial:
    """A joint's place in the chain, and the direction of its needle.

    Attributes:
        column: The joint's entry of q.
        step: The joint in the chain.
        needle: A unit vector (3,) perpendicular to the axis, in the child link's coordinates.
        side: Axis x needle (3,), the needle's direction after a quarter turn.
    """

    name: str
    column: int
    step: ChainJoint
    needle: Vector
    side: Vector

    @property
    def is_prismatic(self) -> bool:
        """Return whether the joint is prismatic."""
        return self.step.joint.kind is JointType.PRISMATIC

    def pivot_and_axis(self, poses: Mapping[str, Matrix]) -> tuple[Vector, Vector]:
        """Return pivot (3,) [m] (zero position if prismatic) and axis (3,), world coordinates."""
        joint = self.step.joint
        T_world_joint = poses[joint.parent] @ joint.origin
        return T_world_joint[:3, 3], T_world_joint[:3, :3] @ joint.axis

    def hub(self, poses: Mapping[str, Matrix], q: Vector) -> Vector:
        """Return the joint's hub (3,): its pivot, shifted by the position if prismatic."""
        pivot, axis = self.pivot_and_axis(poses)
        return pivot + float(q[self.column]) * axis if self.is_prismatic else pivot


def joint_dials(chain: Chain, q: Vector) -> tuple[JointDial, ...]:
    """Return a dial for each joint that q (dof,) moves; needles point to the next joint."""
    moving = [step for step in chain.joints_to() if step.joint.mimic is None and step.scale]
    poses = chain.link_poses(q)
    ends = [(poses[step.joint.parent] @ step.joint.origin)[:3, 3] for step in moving[1:]]
    ends.append(poses[chain.tip][:3, 3])
    return tuple(
        _make_dial(step, _needle_direction(step, poses[step.joint.child], end))
        for step, end in zip(moving, ends, strict=True)
    )


def _make_dial(step: ChainJoint, needle: Vector) -> JointDial:
    side = np.cross(step.joint.axis, needle)
    return JointDial(step.joint.name, step.column, step, needle, side)


def limit_proximity(chain: Chain, q: Vector, column: int) -> LimitProximity:
    """Return ``amber`` near a limit, ``red`` at it, else ``limit``."""
    joint = (float(q[column]), float(chain.lower_rad[column]), float(chain.upper_rad[column]))
    unit = "m" if chain.kinds[column] is JointType.PRISMATIC else "rad"
    return "red" if at_limit(*joint, unit) else "amber" if near_limit(*joint, unit) else "limit"


def _needle_direction(step: ChainJoint, T_world_child: Matrix, towards_m: Vector) -> Vector:
    """Return the direction (3,) to a point, perpendicular to the axis, child's coordinates."""
    axis = step.joint.axis
    offset = T_world_child[:3, :3].T @ (towards_m - T_world_child[:3, 3])
    across = offset - axis * float(axis @ offset)
    if math.sqrt(float(across @ across)) < _MIN_ARM_M:  # a roll joint: any direction
        helper = np.eye(3)[int(np.argmin(np.abs(axis)))]
        across = helper - axis * float(axis @ helper)
    return across / math.sqrt(float(across @ across))


_RADIUS_PX, _HUB_PX = 26.0, 3.0
_STEP_RAD = math.radians(6.0)
# Cosine below which an arc is seen edge-on: its dial is drawn facing the camera instead.
_EDGE_ON_COSINE = 0.4


class JointArcs:
    """The arcs of an arm's joints, laid out for drawing.

    Args:
        chain: The arm inside its own limits.
        dials: Its joints.
    """

    def __init__(self, chain: Chain, dials: Sequence[JointDial]) -> None:
        self._dials = tuple(dials)
        self._columns = [dial.column for dial in dials]
        self._slides = np.array([dial.is_prismatic for dial in dials], dtype=bool)
        steps = [dial.step.joint for dial in dials]
        self._parents, self._children = [s.parent for s in steps], [s.child for s in steps]
        self._origins = np.array([s.origin for s in steps]).reshape(-1, 4, 4)
        self._axes = np.array([s.axis for s in steps]).reshape(-1, 3)
        self._needles = np.array([[d.needle, d.side] for d in dials]).reshape(-1, 2, 3)
        ranges = [(chain.lower_rad[c], chain.upper_rad[c]) for c in self._columns]
        marks = [_arc_angles(dial, *range_) for dial, range_ in zip(dials, ranges, strict=True)]
        self._marks = np.concatenate([m for m, _ in marks])
        self._fixed = np.concatenate([s for _, s in marks])
        self._owner = np.repeat(np.arange(len(marks)), [len(m) for m, _ in marks])
        self._ends = np.cumsum([len(m) for m, _ in marks]).tolist()

    def draw_arcs(
        self, q: Vector, poses: Mapping[str, Matrix], camera: Camera, styles: Sequence[str]
    ) -> list[list[DrawItem]]:
        """Return arc, needle and hub of each joint; the arc in its own style.

        Args:
            q: Joints (dof,).
            poses: T_world_link (4, 4) of every link.
            camera: The camera.
            styles: One for each joint.
        """
        now = q[self._columns]
        T = np.array([poses[link] for link in self._parents]) @ self._origins
        pivots, axes = T[:, :3, 3], np.einsum("nij,nj->ni", T[:, :3, :3], self._axes)
        hubs = pivots + np.where(self._slides, now, 0.0)[:, None] * axes
        points = self._arc_points(now, pivots, axes, poses, camera)
        px = to_pixels(camera.project(np.concatenate([points, hubs]))[0])
        begins, hubs_px = [0, *self._ends], px[self._ends[-1] :]
        return [
            _arc_items(dial, px[begins[i] : begins[i + 1]], hubs_px[i], styles[i])
            for i, dial in enumerate(self._dials)
        ]

    def _arc_points(
        self, now: Vector, pivots: Matrix, axes: Matrix, poses: Mapping[str, Matrix], camera: Camera
    ) -> Matrix:
        """Return the points (k, 3) of all arcs and tracks, joint by joint."""
        across, edge_on = self._arc_planes(pivots, axes, poses, camera)
        owner, slides = self._owner, self._slides[self._owner]
        angles = self._marks + (edge_on[owner] - self._fixed) * now[owner]
        first = np.where(slides, self._marks, np.cos(angles))[:, None] * across[owner, 0]
        second = np.where(slides, 0.0, np.sin(angles))[:, None] * across[owner, 1]
        points: Matrix = pivots[owner] + first + second
        return points

    def _arc_planes(
        self, pivots: Matrix, axes: Matrix, poses: Mapping[str, Matrix], camera: Camera
    ) -> tuple[Matrix, Vector]:
        """Return the axes (n, 2, 3) of each arc's plane, and which arcs are seen edge-on.

        The first axis of a track is along the prismatic joint.
        """
        R = np.array([poses[link][:3, :3] for link in self._children])
        across = np.einsum("nij,nkj->nki", R, self._needles)
        lines_of_sight = pivots - camera.eye_m if camera.perspective else camera.forward[None]
        level = np.abs(np.sum(axes * lines_of_sight, axis=1))
        edge_on = level < _EDGE_ON_COSINE * np.sqrt(np.sum(lines_of_sight * lines_of_sight, axis=1))
        across = np.where(edge_on[:, None, None], [camera.up, camera.right], across)
        radii_m = _RADIUS_PX / camera.pixels_per_metre(camera.depth_of(pivots))
        across = across * radii_m[:, None, None]
        across[self._slides, 0] = axes[self._slides]
        return across, edge_on.astype(np.float64)


def _arc_angles(dial: JointDial, low: float, high: float) -> tuple[Vector, NDArray[np.float64]]:
    """Return the angles of the arc's points (k,), and 1 for those fixed while the needle rotates.

    The last point is the needle's end; the circle of a continuous joint rotates with it.
    """
    if dial.is_prismatic:
        return np.array([low, high]), np.zeros(2)
    is_continuous = not math.isfinite(high - low)
    low, high = (-math.pi, math.pi) if is_continuous else (low, high)
    count = max(2, math.ceil((high - low) / _STEP_RAD) + 1)
    fixed = np.full(count + 1, 0.0 if is_continuous else 1.0)
    fixed[-1] = 0.0
    return np.append(np.linspace(low, high, count), 0.0), fixed


def _arc_items(dial: JointDial, points: list[object], hub: object, style: str) -> list[DrawItem]:
    names = {"joint": dial.name}
    line = points if dial.is_prismatic else points[:-1]
    arc: DrawItem = {"kind": "polyline", "style": style, "points": line, **names}
    centre: DrawItem = {"kind": "circle", "style": "hub", "at": hub, "r": _HUB_PX, **names}
    if dial.is_prismatic:
        return [arc, centre]
    tip = [hub, points[-1]]
    return [arc, {"kind": "polyline", "style": "needle", "points": tip, **names}, centre]

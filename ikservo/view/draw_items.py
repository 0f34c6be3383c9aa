"""Drawing primitives as JSON-ready dicts, the target marker, link poses.

Every item has ``kind`` and ``style``; lists are in painting order::

    {"kind": "polygon",  "style": "measured", "rings": [[[x, y], …], …], …}   fill by non-zero rule
    {"kind": "polyline", "style": "floor",    "points": [[x, y], …]}
    {"kind": "circle",   "style": "tip",      "at": [x, y], "r": 4.0}
    {"kind": "cross",    "style": "target",   "at": [x, y], "r": 8.0}
    {"kind": "text",     "style": "scale",    "at": [x, y], "text": "10 cm"}

Rings of one polygon may overlap: filled together they are one shape; to outline it, stroke twice
the width first and fill over it. Items of a link have ``link``, those of a joint ``joint``; its
arc has a ``label`` with the joint's position, its limits and where they come from.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from ikservo.ik import ActiveLimit
from ikservo.kinematics import Chain, Joint
from ikservo.kinematics.arrays import Matrix, Vector
from ikservo.view.camera import Camera

__all__ = [
    "DrawItem",
    "TargetMarker",
    "circle",
    "cross",
    "draw_target",
    "link_poses",
    "other_joint_position",
    "polygon",
    "polyline",
    "polylines",
    "text",
    "to_pixels",
]


DrawItem = dict[str, object]


def polygon(style: str, rings_px: Matrix | Sequence[ArrayLike], **names: str) -> DrawItem:
    """Return closed outlines (k, 2), or equally long ones (n, k, 2), that are filled together."""
    equally_long = isinstance(rings_px, np.ndarray)  # all rings at once are ten times as fast
    rings = to_pixels(rings_px) if equally_long else [to_pixels(ring) for ring in rings_px]
    return {"kind": "polygon", "style": style, "rings": rings, **names}


def polyline(style: str, points_px: ArrayLike, **names: str) -> DrawItem:
    """Return an open line through pixels (k, 2)."""
    return {"kind": "polyline", "style": style, "points": to_pixels(points_px), **names}


def polylines(style: str, lines_px: Matrix) -> list[DrawItem]:
    """Return many lines (n, k, 2)."""
    return [{"kind": "polyline", "style": style, "points": line} for line in to_pixels(lines_px)]


def circle(style: str, at_px: ArrayLike, r_px: float, **names: str) -> DrawItem:
    """Return a circle about a pixel (2,)."""
    return {"kind": "circle", "style": style, "at": to_pixels(at_px), "r": r_px, **names}


def cross(style: str, at_px: ArrayLike, r_px: float) -> DrawItem:
    """Return a cross about a pixel (2,)."""
    return {"kind": "cross", "style": style, "at": to_pixels(at_px), "r": r_px}


def text(style: str, at_px: ArrayLike, string: str, **names: str) -> DrawItem:
    """Return a text whose lower left corner is at a pixel (2,)."""
    return {"kind": "text", "style": style, "at": to_pixels(at_px), "text": string, **names}


def to_pixels(points_px: ArrayLike) -> list[object]:
    """Return pixels (…, 2) as nested lists, rounded to 0.1 and clipped so that drawing works."""
    px = np.asarray(points_px, dtype=np.float64)
    rounded: list[object] = (
        np.rint(np.minimum(np.maximum(px, -_FAR_PX), _FAR_PX) * 10) / 10
    ).tolist()
    return rounded


_FAR_PX = 1e5


_CROSS_PX, _RING_PX = 9.0, 5.0


@dataclass(frozen=True, slots=True, eq=False)
class TargetMarker:
    """A target, and the point that the solver reached.

    Attributes:
        target_m: The target point (3,), metres, base frame.
        nearest_m: The point (3,) at the goal.
        reached: Whether these are the same.
        binding: The active limits.
        frame: The link that was grabbed; None for the tip.
        turn_error_rad: How far the tool is from the orientation that was wanted of it; 0 if none.
    """

    target_m: Vector
    nearest_m: Vector
    reached: bool
    binding: tuple[ActiveLimit, ...] = ()
    frame: str | None = None
    turn_error_rad: float = 0.0

    @property
    def gap_m(self) -> float:
        """Return how far the nearest point is from the target."""
        return float(np.linalg.norm(self.target_m - self.nearest_m))


def draw_target(marker: TargetMarker, camera: Camera, *, refused: bool = False) -> list[DrawItem]:
    """Return a green cross, or a red one with the nearest point and a line between the two.

    Args:
        marker: The target.
        camera: The camera.
        refused: Whether the guard refuses its goal: the cross is red.
    """
    ends, _ = camera.project(np.array([marker.target_m, marker.nearest_m]))
    if marker.reached:
        return [cross("target_refused" if refused else "target", ends[0], _CROSS_PX)]
    return [
        polyline("gap", ends),
        circle("nearest", ends[1], _RING_PX),
        cross("target_far", ends[0], _CROSS_PX),
    ]


def link_poses(chain: Chain, q: Vector, other_joints: Mapping[str, float]) -> dict[str, Matrix]:
    """Return T_world_link (4, 4) of every link.

    Args:
        chain: The arm.
        q: Joints (dof,).
        other_joints: Positions of joints that q does not move, rad or m; missing ones are at zero.
    """
    poses = {chain.base: np.eye(4)}
    for link in chain.frames:
        if link == chain.base:
            continue
        step = chain.joints_to(link)[-1]
        value = None if step.scale else other_joint_position(step.joint, other_joints)
        motion = step.motion(q) if value is None else step.motion_at(value)
        poses[link] = poses[step.joint.parent] @ step.joint.origin @ motion
    return poses


def other_joint_position(joint: Joint, other_joints: Mapping[str, float]) -> float | None:
    """Return the position of a joint that q does not move, rad or m; None if it is not known."""
    if joint.mimic is None:
        return other_joints.get(joint.name)
    leader = other_joints.get(joint.mimic.joint)
    return None if leader is None else joint.mimic.multiplier * leader + joint.mimic.offset

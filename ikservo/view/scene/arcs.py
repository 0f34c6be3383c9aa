"""Each joint's range as an arc with a needle, or as a track where the joint slides, all at once.

A picture is made sixty times a second, so the points of all arcs are put in place and projected
together: one joint or ten cost nearly the same.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from ikservo.kinematics import Chain
from ikservo.kinematics.se3 import Matrix, Vector
from ikservo.view.camera.camera import Camera
from ikservo.view.scene.dials import Dial
from ikservo.view.scene.items import Item, pixels

__all__ = ["Arcs"]

_RADIUS_PX, _HUB_PX = 26.0, 3.0
_STEP_RAD = math.radians(6.0)
# An axis flatter to the screen than this shows its arc as a line: the dial is turned to the eye.
_EDGE_ON = 0.4


class Arcs:
    """The arcs of an arm's joints, laid out for drawing.

    Args:
        chain: The arm inside its own limits.
        dials: Its joints.
    """

    def __init__(self, chain: Chain, dials: Sequence[Dial]) -> None:
        self._dials = tuple(dials)
        self._columns = [dial.column for dial in dials]
        self._slides = np.array([dial.slides for dial in dials], dtype=bool)
        steps = [dial.step.joint for dial in dials]
        self._parents, self._children = [s.parent for s in steps], [s.child for s in steps]
        self._origins = np.array([s.origin for s in steps]).reshape(-1, 4, 4)
        self._axes = np.array([s.axis for s in steps]).reshape(-1, 3)
        self._needles = np.array([[d.needle, d.side] for d in dials]).reshape(-1, 2, 3)
        ranges = [(chain.lower_rad[c], chain.upper_rad[c]) for c in self._columns]
        marks = [_marks(dial, *range_) for dial, range_ in zip(dials, ranges, strict=True)]
        self._marks = np.concatenate([m for m, _ in marks])
        self._stands = np.concatenate([s for _, s in marks])
        self._owner = np.repeat(np.arange(len(marks)), [len(m) for m, _ in marks])
        self._ends = np.cumsum([len(m) for m, _ in marks]).tolist()

    def drawn(
        self, q: Vector, poses: Mapping[str, Matrix], camera: Camera, styles: Sequence[str]
    ) -> list[list[Item]]:
        """Return arc, needle and hub of each joint; the arc in its own style.

        Args:
            q: Joints (dof,).
            poses: T_world_link (4, 4) of every link.
            camera: Where from.
            styles: One for each joint.
        """
        now = q[self._columns]
        T = np.array([poses[link] for link in self._parents]) @ self._origins
        pivots, axes = T[:, :3, 3], np.einsum("nij,nj->ni", T[:, :3, :3], self._axes)
        hubs = pivots + np.where(self._slides, now, 0.0)[:, None] * axes
        points = self._points(now, pivots, axes, poses, camera)
        px = pixels(camera.project(np.concatenate([points, hubs]))[0])
        begins, hubs_px = [0, *self._ends], px[self._ends[-1] :]
        return [
            _items(dial, px[begins[i] : begins[i + 1]], hubs_px[i], styles[i])
            for i, dial in enumerate(self._dials)
        ]

    def _points(
        self, now: Vector, pivots: Matrix, axes: Matrix, poses: Mapping[str, Matrix], camera: Camera
    ) -> Matrix:
        """Return the points (k, 3) of all arcs and tracks, one joint's after the other's."""
        across, turned = self._across(pivots, axes, poses, camera)
        owner, slides = self._owner, self._slides[self._owner]
        angles = self._marks + (turned[owner] - self._stands) * now[owner]
        first = np.where(slides, self._marks, np.cos(angles))[:, None] * across[owner, 0]
        second = np.where(slides, 0.0, np.sin(angles))[:, None] * across[owner, 1]
        points: Matrix = pivots[owner] + first + second
        return points

    def _across(
        self, pivots: Matrix, axes: Matrix, poses: Mapping[str, Matrix], camera: Camera
    ) -> tuple[Matrix, Vector]:
        """Return the directions (n, 2, 3) in which each arc lies, and which are turned to the eye.

        Those of a track are along the slide.
        """
        R = np.array([poses[link][:3, :3] for link in self._children])
        across = np.einsum("nij,nkj->nki", R, self._needles)
        sights = pivots - camera.eye_m if camera.perspective else camera.forward[None]
        level = np.abs(np.sum(axes * sights, axis=1))
        turned = level < _EDGE_ON * np.sqrt(np.sum(sights * sights, axis=1))
        across = np.where(turned[:, None, None], [camera.up, camera.right], across)
        radii_m = _RADIUS_PX / camera.pixels_per_metre(camera.depth_of(pivots))
        across = across * radii_m[:, None, None]
        across[self._slides, 0] = axes[self._slides]
        return across, turned.astype(np.float64)


def _marks(dial: Dial, low: float, high: float) -> tuple[Vector, NDArray[np.float64]]:
    """Return where the arc's points are (k,), and which stand while the needle turns (1, else 0).

    The needle's own end is the last; a joint that turns freely carries its circle with it.
    """
    if dial.slides:
        return np.array([low, high]), np.zeros(2)
    free = not math.isfinite(high - low)
    low, high = (-math.pi, math.pi) if free else (low, high)
    count = max(2, math.ceil((high - low) / _STEP_RAD) + 1)
    stands = np.full(count + 1, 0.0 if free else 1.0)
    stands[-1] = 0.0
    return np.append(np.linspace(low, high, count), 0.0), stands


def _items(dial: Dial, points: list[object], hub: object, style: str) -> list[Item]:
    names = {"joint": dial.name}
    line = points if dial.slides else points[:-1]
    arc: Item = {"kind": "polyline", "style": style, "points": line, **names}
    centre: Item = {"kind": "circle", "style": "hub", "at": hub, "r": _HUB_PX, **names}
    if dial.slides:
        return [arc, centre]
    tip = [hub, points[-1]]
    return [arc, {"kind": "polyline", "style": "needle", "points": tip, **names}, centre]

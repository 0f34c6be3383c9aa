"""Turning one joint with the pointer: by the angle about its axis, as it is seen."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np

from ikservo.kinematics.se3 import Vector
from ikservo.view.camera.camera import Camera

__all__ = ["Turning", "begin"]

# An axis flatter to the screen than this shows its circle as a line.
_FACING = 0.3
_HUB_PX = 5.0
_LEAST_LEVER_PX = 20.0
_LEVERLESS_RAD_PX = math.radians(0.5)
_SMALL = 1e-4


@dataclass(frozen=True, slots=True, eq=False)
class Turning:
    """A joint that the pointer turns.

    Attributes:
        column: The joint's entry of q.
        camera: The camera the gesture began with.
        pivot_m: A point (3,) of the axis.
        axis: The axis (3,), a unit vector.
        px: Where the pointer was last (2,).
        position: Where the pointer wants the joint, rad or m; may be past its limits, so that a
            pointer which comes back meets the joint where it left it.
        lever_px: How the grabbed point moves on the screen (2,) with the joint, pixels for each
            rad or m; None where the pointer goes round the pivot instead.
    """

    column: int
    camera: Camera
    pivot_m: Vector
    axis: Vector
    px: Vector
    position: float
    lever_px: Vector | None

    def moved(self, px: Vector) -> Turning:
        """Return the gesture after the pointer has moved to a pixel (2,)."""
        return replace(self, px=px, position=self.position + self._change(px))

    def _change(self, px: Vector) -> float:
        if self.lever_px is not None:
            return float((px - self.px) @ self.lever_px) / float(self.lever_px @ self.lever_px)
        before, now = self._angle(self.px), self._angle(px)
        return 0.0 if before is None or now is None else math.remainder(now - before, math.tau)

    def _angle(self, px: Vector) -> float | None:
        """Return the pointer's angle about the axis; None on the pivot, where it has none."""
        hub, _ = self.camera.project(self.pivot_m)
        met = self.camera.ray(px).meets_plane(self.pivot_m, self.axis)
        if met is None or float(np.hypot(*(px - hub))) < _HUB_PX:
            return None
        across = self.camera.right - self.axis * float(self.axis @ self.camera.right)
        if float(across @ across) < 0.1:
            across = self.camera.up - self.axis * float(self.axis @ self.camera.up)
        arm = met - self.pivot_m
        return math.atan2(float(np.cross(self.axis, across) @ arm), float(across @ arm))


def begin(
    column: int,
    camera: Camera,
    line: tuple[Vector, Vector],
    px: Vector,
    point_m: Vector,
    position: float,
    *,
    slides: bool,
) -> Turning:
    """Begin to turn a joint.

    Args:
        column: The joint's entry of q.
        camera: What the person sees.
        line: A point (3,) of the axis, and its direction (3,).
        px: Where the pointer is (2,).
        point_m: The grabbed point (3,).
        position: The joint's position, rad or m.
        slides: Whether the joint is a slide.
    """
    pivot, axis = line
    sight = camera.ray(camera.project(pivot)[0]).direction
    lever = None
    if slides or abs(float(sight @ axis)) < _FACING:
        lever = _lever(camera, axis if slides else np.cross(axis, point_m - pivot), point_m)
    return Turning(column, camera, pivot, axis, px, position, lever)


def _lever(camera: Camera, velocity: Vector, point_m: Vector) -> Vector:
    """Return how a point moves on the screen (2,) at a velocity (3,); upwards if hardly at all."""
    ends, _ = camera.project(point_m + np.array([[-_SMALL], [_SMALL]]) * velocity)
    lever: Vector = (ends[1] - ends[0]) / (2.0 * _SMALL)
    upwards = np.array([0.0, -1.0 / _LEVERLESS_RAD_PX])
    return lever if float(lever @ lever) > _LEAST_LEVER_PX**2 else upwards

"""Where the arm is sent: the target, the nearest point that it can reach, and how it is drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ikservo.ik import Binding
from ikservo.kinematics.se3 import Vector
from ikservo.view.camera.camera import Camera
from ikservo.view.scene.items import Item, circle, cross, polyline

__all__ = ["Aim", "draw_aim"]

_CROSS_PX, _RING_PX = 9.0, 5.0


@dataclass(frozen=True, slots=True, eq=False)
class Aim:
    """A target, and what the solver made of it.

    Attributes:
        target_m: Where the point shall be (3,), metres, base frame.
        nearest_m: Where the goal puts it (3,).
        reached: Whether these are the same.
        binding: The limits that hold the arm back.
        frame: The link that was grabbed; None for the tip.
    """

    target_m: Vector
    nearest_m: Vector
    reached: bool
    binding: tuple[Binding, ...] = ()
    frame: str | None = None

    @property
    def gap_m(self) -> float:
        """Return how far the nearest point is from the target."""
        return float(np.linalg.norm(self.target_m - self.nearest_m))


def draw_aim(aim: Aim, camera: Camera) -> list[Item]:
    """Return a green cross, or a red one with the nearest point and the way that is missing."""
    ends, _ = camera.project(np.array([aim.target_m, aim.nearest_m]))
    if aim.reached:
        return [cross("target", ends[0], _CROSS_PX)]
    return [
        polyline("gap", ends),
        circle("nearest", ends[1], _RING_PX),
        cross("target_far", ends[0], _CROSS_PX),
    ]

"""The sticks of a gamepad: held over, they move the tip's target steadily across the screen."""

from __future__ import annotations

import numpy as np

from ikservo.ik import Target
from ikservo.kinematics.se3 import Vector
from ikservo.view.camera.camera import Camera
from ikservo.view.drag.wishes import Pull
from ikservo.view.server.messages import Gamepad

__all__ = ["Sticks"]

_SPEED_M_S = 0.12
_LONGEST_S = 0.1  # between two messages; after more the sticks were let go
_LEAD_M = 0.05  # a target that the arm cannot follow does not run away


class Sticks:
    """Remembers where the sticks have brought the target."""

    def __init__(self) -> None:
        self._target_m: Vector | None = None
        self._last_s = -1e9

    def wish(self, message: Gamepad, camera: Camera, tip_m: Vector, now_s: float) -> Pull | None:
        """Return where the tip shall go now.

        Args:
            message: How far the sticks are held over.
            camera: What the person sees: right, up and towards them are those of the screen.
            tip_m: Where the goal so far has the tip (3,).
            now_s: The time.
        """
        elapsed_s, self._last_s = now_s - self._last_s, now_s
        x, y, _, towards = message.axes
        if not (x or y or towards):
            self._target_m = None
            return None
        if self._target_m is None or elapsed_s > _LONGEST_S:
            self._target_m = tip_m
            elapsed_s = min(elapsed_s, _LONGEST_S)
        way = camera.R_world_view @ np.array([x, y, -towards]) * (_SPEED_M_S * elapsed_s)
        target = self._target_m + way
        lead = target - tip_m
        far = float(np.linalg.norm(lead))
        self._target_m = target if far <= _LEAD_M else tip_m + lead * (_LEAD_M / far)
        return Pull(Target(self._target_m))

"""Controls that move while they are held: gripper buttons and the sticks of a gamepad."""

from __future__ import annotations

import numpy as np

from ikservo.apps.page.dragging.drag_commands import DragTarget
from ikservo.apps.page.messages.page_messages import Gamepad
from ikservo.apps.page.picking.projection import Camera
from ikservo.arm import Arm
from ikservo.ik import Target
from ikservo.kinematics.arrays import Vector

_FULL_TRAVEL_S = 1.5  # time from closed to open
_LEAD_FRACTION = 0.06  # largest lead of a blocked gripper, as a fraction of its range
_MAX_STEP_S = 0.1  # a longer gap between two messages counts as released


class GripperControl:
    """Integrator of the gripper's speed while a button is held.

    Args:
        column: Index of the gripper among all joints.
        closed: The closed position, rad or m.
        opened: The open position, rad or m.
    """

    def __init__(self, column: int, closed: float, opened: float) -> None:
        self.column = column
        self._closed, self._opened = closed, opened
        self._last_s = -1e9

    def next_position(
        self, grip: float, goal: float, measured: Vector | None, now_s: float
    ) -> float | None:
        """Compute the next joint goal, rad or m; None while no button is held.

        A ``grip`` of 1 closes, -1 opens, and smaller values move more slowly. The goal leads the
        ``measured`` joints (n,) only a little, so that the jaws do not press hard. In the preview,
        ``measured`` is None, and the lead is not limited.
        """
        elapsed_s, self._last_s = min(now_s - self._last_s, _MAX_STEP_S), now_s
        if not grip:
            return None
        travel = self._closed - self._opened
        target = goal + grip * travel * elapsed_s / _FULL_TRAVEL_S
        if measured is not None:
            at, ahead = float(measured[self.column]), abs(travel) * _LEAD_FRACTION
            target = min(max(target, at - ahead), at + ahead)
        low, high = sorted((self._closed, self._opened))
        return min(max(target, low), high)


def gripper_control(arm: Arm) -> GripperControl | None:
    """Return the gripper control within the calibrated limits; None without a gripper."""
    gripper = arm.model.gripper
    if gripper is None:
        return None
    column = [joint.name for joint in arm.model.joints].index(gripper.joint)
    lower, upper = arm.limits()
    low, high = float(lower[column]), float(upper[column])
    ends = (min(max(end, low), high) for end in (gripper.closed, gripper.open))
    return GripperControl(column, *ends)


_SPEED_M_S = 0.12
_LEAD_M = 0.05  # largest lead of the target if the arm cannot follow


class GamepadControl:
    """Integrator that turns the deflection of the sticks into a target."""

    def __init__(self) -> None:
        self._target_m: Vector | None = None
        self._last_s = -1e9

    def make_command(
        self, message: Gamepad, camera: Camera, tip_m: Vector, now_s: float
    ) -> DragTarget | None:
        """Return the next target, given the tip goal (3,); None while the sticks are centred.

        Directions are relative to the screen.
        """
        elapsed_s, self._last_s = now_s - self._last_s, now_s
        x, y, _, towards = message.axes
        if not (x or y or towards):
            self._target_m = None
            return None
        if self._target_m is None or elapsed_s > _MAX_STEP_S:
            self._target_m = tip_m
            elapsed_s = min(elapsed_s, _MAX_STEP_S)
        step = camera.R_world_view @ np.array([x, y, -towards]) * (_SPEED_M_S * elapsed_s)
        target = self._target_m + step
        lead = target - tip_m
        distance_m = float(np.linalg.norm(lead))
        self._target_m = target if distance_m <= _LEAD_M else tip_m + lead * (_LEAD_M / distance_m)
        return DragTarget(Target(self._target_m))

"""Contents of a frame of a page, before they are converted to message fields."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from ikservo.apps.page.dragging.goal_planning import PlannedPath
from ikservo.apps.page.dragging.target_marker import TargetMarker
from ikservo.apps.page.drawing.reachable_region import ReachableRegion
from ikservo.apps.page.picking.projection import Camera
from ikservo.kinematics.arrays import Vector

_SAME_RAD = 2e-3


@dataclass(frozen=True, slots=True, eq=False)
class SceneState:
    """Contents of a frame.

    Attributes:
        camera: The camera.
        measured: Measured joints (dof,), rad or m.
        goal: Goal of the joints (dof,); None while there is no goal.
        path: The path to the goal, if there is one.
        is_choosing: Whether the goal is still being chosen; postures on the path are then hidden.
        marker: The target, if there is one.
        region: The reachable region of the shown plane, if it is available.
        hover: The link under the pointer.
        grabbed: The link that is being dragged.
        behind: Whether the hovered link is behind other links; its outline is then drawn on top.
        picked: The object of the scene under the pointer.
        refused_pair: The pair that the goal would touch, if the guard refuses it; may be empty.
            None for a goal that is not refused.
        other_joints: Positions of joints that are not in the chain, such as the gripper's.
        goal_other_joints: The goals of the other joints; None if the other joints stay.
    """

    camera: Camera
    measured: Vector
    goal: Vector | None = None
    path: PlannedPath | None = None
    is_choosing: bool = False
    marker: TargetMarker | None = None
    region: ReachableRegion | None = None
    hover: str | None = None
    grabbed: str | None = None
    behind: bool = False
    picked: str | None = None
    refused_pair: tuple[str, ...] | None = None
    other_joints: Mapping[str, float] = field(default_factory=dict[str, float])
    goal_other_joints: Mapping[str, float] | None = None

    @property
    def shows_goal(self) -> bool:
        """Whether there is a goal that differs from the measured position, or several motions.

        Differences below the resolution of servos are ignored. Several motions may end where they
        begin.
        """
        if self.goal is None:
            return False
        if self.path is not None and self.path.run is not None:
            return True
        others = self.goal_other_joints or {}
        away = [abs(others[name] - at) for name, at in self.other_joints.items() if name in others]
        return max(float(np.abs(self.goal - self.measured).max()), *away, 0.0) >= _SAME_RAD

"""Drawing of the limp arm during a calibration, and of the pose in which to hold it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from ikservo.apps.calibrating.by_hand_procedure import CalibrationStage
from ikservo.apps.page.dragging.snapshot import CalibrationView
from ikservo.apps.page.drawing.view_picture import SceneState
from ikservo.apps.page.running.calibration_panel import REFERENCE_POSE
from ikservo.calibration import JointMap
from ikservo.kinematics.arrays import Vector
from ikservo.maintenance.dialogue import HandRequest
from ikservo.model import Model


class LimpPicture:
    """Positions of the joints for drawing during a calibration.

    Until the reference pose is recorded, the zeros are unknown: joints start from their previous
    positions and move as their servos turn. After that, the calibration gives their positions.

    Args:
        joint_maps: The map of each joint before the calibration.
        measured: The joints (n,) that were shown before, rad or m.
    """

    def __init__(self, joint_maps: Sequence[JointMap], measured: Vector) -> None:
        self._maps, self._start = joint_maps, measured
        self._first: Mapping[int, int] = {}

    def positions(self, request: HandRequest | None) -> Vector:
        """Compute the joint positions (n,) to draw, rad or m, from the readings in a request."""
        if request is None:
            return self._start
        if request.readings:
            known = {each.name: each.position for each in request.readings}
            names = [joint_map.joint for joint_map in self._maps]
            pairs = zip(names, self._start.tolist(), strict=True)
            return np.array([known.get(name, start) for name, start in pairs])
        self._first = self._first or request.ticks
        positions: list[float] = []
        for joint_map, start in zip(self._maps, self._start.tolist(), strict=True):
            turned = request.ticks[joint_map.servo_id] - self._first[joint_map.servo_id]
            positions.append(joint_map.position(joint_map.exact_tick(start) + turned))
        return np.array(positions)


def show_calibration(scene: SceneState, view: CalibrationView, model: Model) -> SceneState:
    """Show in a scene what a calibration requests: the pose to hold, then the joint to move."""
    if view.stage == CalibrationStage.REFERENCE_POSE:
        pose = model.pose(REFERENCE_POSE)
        return replace(scene, goal=model.chain_pose(REFERENCE_POSE), goal_other_joints=pose)
    current = view.item.current if isinstance(view.item, HandRequest) else ""
    if not current:
        return scene
    moved = next(joint.child for joint in model.urdf.joints if joint.name == current)
    return replace(scene, hover=moved)

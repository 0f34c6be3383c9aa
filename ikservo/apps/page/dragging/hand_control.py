"""Goals from a hand or phone that the user moves as if it held the gripper."""

from __future__ import annotations

from typing import Any

import numpy as np

from ikservo.app_discovery import find_part
from ikservo.apps.page.dragging.snapshot import ArmSnapshot, GoalRefusal
from ikservo.apps.page.dragging.target_marker import TargetMarker
from ikservo.apps.page.messages.page_messages import TrackHand
from ikservo.arm import Arm
from ikservo.kinematics.arrays import Vector
from ikservo.kinematics.se3 import make_pose, quaternion_to_matrix
from ikservo.model.tool import tool_frame

_SHOWN_GAP_M = 0.005  # a target that is further away from the goal is marked


class HandControl:
    """Moves the goal with the user's hand while the clutch is closed.

    Args:
        arm: The arm to move.

    Attributes:
        is_held: Whether the clutch is closed.
        limit: Reason why the goal is not where the hand wants it; empty if it is.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm = arm
        self._filter: Any = None  # of an app that may be missing
        self._speed = ""
        self._refusal: GoalRefusal | None = None
        self.is_held, self.limit = False, ""

    def release(self) -> None:
        """Open the clutch."""
        self.is_held, self.limit = False, ""
        if self._filter is not None:
            self._filter.release()

    def next_goal(
        self, message: TrackHand, goal: Vector, snapshot: ArmSnapshot, speed: str, now_s: float
    ) -> tuple[Vector, TargetMarker | None]:
        """Return the next goal of all joints (n,), and the target that the hand wants.

        Args:
            message: The pose of the hand.
            goal: The last goal (n,); after a refusal, the filter continues from the kept one.
            snapshot: The state of the arm.
            speed: The speed class.
            now_s: The time.

        Raises:
            InputError: The rotation is invalid, or the app that follows hands is not installed.
        """
        pose = make_pose(message.position, quaternion_to_matrix(message.rotation))
        tracked = find_part("tracked pose")(pose, held=message.held)
        pose_filter = self._filter_at(speed, message.scale)
        refusal, index = snapshot.refusal, self._arm.joint_index
        if refusal is not None and refusal.kept is not None:
            is_new = self.is_held and refusal is not self._refusal
            goal = refusal.kept if is_new or refusal.goal is goal else goal
            if is_new:
                pose_filter.on_rejected(refusal.pair, index.chain_joints(refusal.kept))
        self._refusal, self.is_held = refusal, message.held
        q = pose_filter.step(tracked, index.chain_joints(goal), now_s)
        self.limit = pose_filter.limit
        if pose_filter.wanted is None:
            return goal, None
        wanted_m, nearest_m = pose_filter.wanted[:3, 3], self._arm.chain.forward(q)[:3, 3]
        is_near = bool(np.linalg.norm(wanted_m - nearest_m) <= _SHOWN_GAP_M)
        return index.with_chain(goal, q), TargetMarker(wanted_m, nearest_m, is_near)

    def _filter_at(self, speed: str, scale: float) -> Any:  # noqa: ANN401
        """Return the filter for a speed class; a change of either argument opens the clutch."""
        arm = self._arm
        if self._filter is None or speed != self._speed:
            limits = arm.context.planner.motion_limits(speed)
            chain_limits = [limits[column] for column in arm.joint_index.chain]
            axis = tool_frame(arm.model).approach_axis
            self._filter = find_part("pose filter")(arm.chain, axis, chain_limits)
            self._speed = speed
        if scale != self._filter.scale:
            self._filter.scale = scale
        return self._filter

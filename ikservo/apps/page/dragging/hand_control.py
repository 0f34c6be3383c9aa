"""Goals from a hand or phone that the user moves as if it held the gripper."""

from __future__ import annotations

from collections import deque
from typing import Any

import numpy as np

from ikservo.app_discovery import find_part
from ikservo.apps.page.dragging.snapshot import ArmSnapshot, GoalRefusal
from ikservo.apps.page.dragging.target_marker import TargetMarker
from ikservo.apps.page.messages.page_messages import TrackHand
from ikservo.arm import DEAD_MAN_TIMEOUT_S, Arm
from ikservo.kinematics.arrays import Vector
from ikservo.kinematics.se3 import make_pose, quaternion_to_matrix
from ikservo.model.tool import tool_frame

_SHOWN_GAP_M = 0.005  # a target that is further away from the goal is marked
_LET_GO = "let go first"
_MAX_REMEMBERED = 64


class HandControl:
    """Control of the goal by the user's hand while the clutch is closed.

    Each press of the user has a number. Once the clutch has opened, for any reason, the same
    press does not close it again.

    Args:
        arm: The arm to move.

    Attributes:
        spent: Numbers of the latest presses that no longer close the clutch.
        limit: Reason why the goal does not follow the hand exactly; empty if it does.
    """

    def __init__(self, arm: Arm) -> None:
        self._arm, self.spent = arm, deque[int](maxlen=_MAX_REMEMBERED)
        self._clutch: int | None = None  # the press that holds it closed
        self._newest_s = 0.0
        self._filter: Any = None  # of an app that may be missing
        self._speed = ""
        self._refusal: GoalRefusal | None = None
        self.limit = ""

    @property
    def is_held(self) -> bool:
        """Whether the clutch is closed."""
        return self._clutch is not None

    def release(self) -> None:
        """Open the clutch until the next press."""
        if self._clutch is not None:
            self.spend(self._clutch)
        self._clutch, self.limit = None, ""
        if self._filter is not None:
            self._filter.release()

    def refuse(self, message: TrackHand) -> None:
        """Open the clutch; the button press that sent the message cannot close it again."""
        self.release()
        if message.held:
            self.limit = _LET_GO
            self.spend(message.clutch)

    def spend(self, clutch: int) -> None:
        """Remember that a press no longer closes the clutch."""
        if clutch not in self.spent:
            self.spent.append(clutch)

    def expire(self, now_s: float) -> None:
        """Open the clutch if the page has sent no pose for too long."""
        if self.is_held and now_s - self._newest_s > DEAD_MAN_TIMEOUT_S:
            self.release()

    def is_new(self, message: TrackHand) -> bool:
        """Check whether a message closes the clutch."""
        return message.held and message.clutch != self._clutch and message.clutch not in self.spent

    def next_goal(
        self, message: TrackHand, goal: Vector, snapshot: ArmSnapshot, speed: str, now_s: float
    ) -> tuple[Vector, TargetMarker | None]:
        """Return the next goal of all joints (n,), and the target that the hand wants.

        Args:
            message: The pose of the hand.
            goal: The last goal (n,); after a refusal, the filter continues from the kept goal.
            snapshot: The state of the arm.
            speed: The speed class.
            now_s: The time.

        Raises:
            InputError: The rotation is invalid, or the app that follows hands is not installed.
        """
        pose = make_pose(message.position, quaternion_to_matrix(message.rotation))
        tracked = find_part("tracked pose")(pose, held=message.held)
        pose_filter = self._filter_at(speed, message.scale)
        if not message.held or message.clutch in self.spent:
            self.refuse(message)
            return goal, None
        refusal, index = snapshot.refusal, self._arm.joint_index
        if refusal is not None and refusal.kept is not None:
            is_new = self.is_held and refusal is not self._refusal
            goal = refusal.kept if is_new or refusal.goal is goal else goal
            if is_new:
                pose_filter.on_rejected(refusal.pair, index.chain_joints(refusal.kept))
        self._refusal, self._clutch, self._newest_s = refusal, message.clutch, now_s
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

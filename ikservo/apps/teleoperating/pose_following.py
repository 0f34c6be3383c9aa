"""``arm.follow_pose``: the tool follows a hand, a phone or another source of poses."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike

from ikservo.apps.teleoperating.pose_filter import MAX_CYCLE_S, PoseFilter, TrackedPose
from ikservo.arguments import check_callable, check_iterable
from ikservo.arm.arm_protocol import OpenArm
from ikservo.arm.following import HAND_JERK_FACTOR, HAND_SLOW_S, follow_targets
from ikservo.arm.opening import require_own_port
from ikservo.errors import CollisionError, RefusedError
from ikservo.guard.dead_man import DEAD_MAN_TIMEOUT_S
from ikservo.kinematics.arrays import Vector
from ikservo.model.tool import tool_frame
from ikservo.planning.context import ArmContext
from ikservo.planning.reports import FollowResult, MotionProgress, OnProgress

_LEAD_FRACTION = 0.06  # largest lead of a blocked gripper, as a fraction of its range


def follow_pose(
    arm: OpenArm,
    poses: Iterable[TrackedPose | ArrayLike | None],
    *,
    scale: float = 1.0,
    speed: str = "normal",
    on_progress: OnProgress | None = None,
) -> FollowResult:
    """Move the tool as a tracked hand moves, relative to where both were at the beginning.

    Each control cycle takes the next item: a ``TrackedPose``, a pose (4, 4) of the hand, or None
    if there is no new pose. Position and orientation are weighted: 1 mm counts like 6°; the
    direction of the tool has priority over the roll about it. The arm omits parts of the motion
    that it cannot follow. If the hand cannot have reached a pose since the last one, the arm does
    not move. Without new poses the goal stays; after 0.3 s, following ends.

    ``scale`` is the ratio of tip motion to hand motion, 0.25 to 2; ``speed`` is the speed
    class; ``on_progress`` is called with a ``MotionProgress`` in every cycle.

    Raises:
        BadValueError: The scale is out of its range, or an item is not a pose.
        RefusedError: The servos are on another machine.
        StoppedError: ``stop`` was called; the arm holds.
    """
    check_callable("on_progress", on_progress)
    check_iterable("The stream of poses", poses, "an iterable of poses")
    own = require_own_port(arm)
    source = _PoseGoals(own.context, iter(poses), scale, speed, on_progress)
    result = follow_targets(
        own,
        source.goals(),
        speed,
        source.on_progress,
        source.on_refused,
        HAND_JERK_FACTOR,
        HAND_SLOW_S,
    )
    ended = source.ended or result.ended.replace("target", "pose")
    return replace(result, ended=ended, unreached=source.unreached)


class _PoseGoals:
    """Joint goals for a stream of poses, one per control cycle.

    Attributes:
        ended: The reason for the time-out; empty if the source or the arm has ended the stream.
        unreached: The number of cycles in which the wanted pose was out of reach.
    """

    def __init__(
        self,
        context: ArmContext,
        poses: Iterator[TrackedPose | ArrayLike | None],
        scale: float,
        speed: str,
        on_progress: OnProgress | None,
    ) -> None:
        self._context, self._poses, self._report = context, poses, on_progress
        self._index = context.index
        self._limits = context.planner.motion_limits(speed)
        axis = tool_frame(context.model).approach_axis
        limits = [self._limits[column] for column in self._index.chain]
        self._filter = PoseFilter(context.chain, axis, limits, scale)
        self._goal = self._measured = np.zeros(0)
        self._opening: float | None = None
        self.ended, self.unreached = "", 0

    def on_progress(self, progress: MotionProgress) -> None:
        """Store the measured positions, and in the first cycle the setpoints as the first goal."""
        self._measured = progress.joints_rad
        if not len(self._goal):
            self._goal = progress.setpoints_rad.copy()
        if self._report:
            self._report(progress)

    def on_refused(self, error: RefusedError, kept: Vector) -> None:
        """Continue from the goal (n,) that the arm kept."""
        self._goal = kept.copy()
        pair = error.pair if isinstance(error, CollisionError) else ()
        self._filter.on_rejected(pair, self._index.chain_joints(kept))

    def goals(self) -> Iterator[dict[str, float]]:
        """Yield the goal of all joints in each cycle, until there are no more poses."""
        cycle_s = newest_s = self._context.now_s()
        for item in self._poses:
            tracked = item if item is None or isinstance(item, TrackedPose) else TrackedPose(item)
            before_s, cycle_s = cycle_s, self._context.now_s()
            if tracked is not None:
                newest_s, self._opening = cycle_s, tracked.opening if tracked.held else None
            elif cycle_s - newest_s > DEAD_MAN_TIMEOUT_S:
                self.ended = f"no pose for {DEAD_MAN_TIMEOUT_S} s"
                return
            q = self._filter.step(tracked, self._index.chain_joints(self._goal), cycle_s)
            self._goal = self._index.with_chain(self._goal, q)
            self._move_gripper(min(cycle_s - before_s, MAX_CYCLE_S))
            self.unreached += self._filter.is_out_of_reach
            yield self._index.by_name(self._goal)

    def _move_gripper(self, elapsed_s: float) -> None:
        """Move the gripper's goal towards the wanted opening, within limits on speed and lead."""
        gripper = self._context.model.gripper
        if gripper is None or self._opening is None:
            return
        column = self._index.column(gripper.joint)
        lower, upper = self._context.limits()
        travel, at = gripper.open - gripper.closed, self._measured[column]
        wanted = min(max(gripper.closed + self._opening * travel, lower[column]), upper[column])
        ahead = abs(travel) * _LEAD_FRACTION
        wanted = min(max(wanted, at - ahead), at + ahead)
        most = self._limits[column].speed_rad_s * elapsed_s
        self._goal[column] += min(max(wanted - self._goal[column], -most), most)
